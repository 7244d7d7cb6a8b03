"""DISK: Tyszkiewicz, Fua and Trulls, "DISK: Learning local features with policy gradient", 2020 (Kornia)."""

import torch
from kornia.feature import DISK

from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.peers.sides import Detections, stereo_from_sides
from polhode.frontend.peers.weights import fill, load_weights
from polhode.frontend.rectification.rectified_pair import RectifiedPair


class DiskFeatures:
    """DISK left and right, matched along the rows."""

    def __init__(self, config: Frontend) -> None:
        self._config = config
        self._network = DISK()
        fill(self._network, load_weights("disk", config.weights), "disk", config.weights)

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Stereo measurements of one rectified pair."""
        return stereo_from_sides(self._detect, pair, rig, self._config)

    def _detect(self, image: torch.Tensor) -> Detections:
        found = self._network(image.expand(-1, 3, -1, -1))[0]
        return Detections(found.keypoints, found.descriptors, found.detection_scores)
