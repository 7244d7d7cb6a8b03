"""ALIKED: Zhao et al., "ALIKED: A lighter keypoint and descriptor extraction network", 2023 (Kornia)."""

import torch
from kornia.feature import ALIKED

from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.peers.sides import Detections, stereo_from_sides
from polhode.frontend.peers.weights import fill, load_weights
from polhode.frontend.rectification.rectified_pair import RectifiedPair

MODEL = "aliked-n16rot"
"""Models n16 and n16rot are one network with two sets of weights."""


class AlikedFeatures:
    """ALIKED left and right, matched along the rows."""

    def __init__(self, config: Frontend) -> None:
        self._config = config
        # A threshold of zero keeps the strongest maxima: their number is ours to choose.
        self._network = ALIKED(
            MODEL, max_num_keypoints=2 * config.features.max_features, detection_threshold=0.0
        )
        fill(self._network, load_weights("aliked", config.weights), "aliked", config.weights)

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Stereo measurements of one rectified pair."""
        return stereo_from_sides(self._detect, pair, rig, self._config)

    def _detect(self, image: torch.Tensor) -> Detections:
        found = self._network(image)[0]
        return Detections(found.keypoints, found.descriptors, found.keypoint_scores)
