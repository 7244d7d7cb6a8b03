"""XFeat: Potje et al., "XFeat: Accelerated features for lightweight image matching", 2024 (Kornia)."""

import torch
from kornia.feature import XFeat

from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.peers.sides import Detections, stereo_from_sides
from polhode.frontend.peers.weights import fill, load_weights
from polhode.frontend.rectification.rectified_pair import RectifiedPair


class XFeatFeatures:
    """XFeat's sparse key points left and right, matched along the rows."""

    def __init__(self, config: Frontend) -> None:
        self._config = config
        self._network = XFeat(top_k=2 * config.features.max_features)
        fill(self._network.net, load_weights("xfeat", config.weights), "xfeat", config.weights)
        self._network.eval()

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Stereo measurements of one rectified pair."""
        return stereo_from_sides(self._detect, pair, rig, self._config)

    def _detect(self, image: torch.Tensor) -> Detections:
        found = self._network.detectAndCompute(image)[0]
        return Detections(found["keypoints"], found["descriptors"], found["scores"])
