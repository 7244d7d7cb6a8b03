"""DISK: Tyszkiewicz, Fua and Trulls, "DISK: Learning local features with policy gradient", 2020 (Kornia)."""

import torch
from kornia.feature import DISK

from frontend.peers.sides import Detections, stereo_from_sides
from frontend.peers.weights import fill, load_weights
from frontend.rectified_pair import RectifiedPair
from frontend.stereo import StereoFeatures
from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend


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
