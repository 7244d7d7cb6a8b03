"""Published detectors and descriptors (by Kornia) as feature methods: DISK, ALIKED and XFeat.

Each finds key points in the left and in the right image; these are matched along the rows as for RootSIFT.
The crop of the target is stretched and enlarged as for RootSIFT, so that the methods differ in what they
find, not in their input. Their key points have neither scale nor orientation.

DISK: Tyszkiewicz, Fua and Trulls, "DISK: Learning local features with policy gradient", 2020. ALIKED: Zhao et
al., "ALIKED: A lighter keypoint and descriptor extraction network", 2023. XFeat: Potje et al., "XFeat:
Accelerated features for lightweight image matching", 2024.
"""

from typing import NamedTuple

import numpy as np
import torch
from kornia.feature import ALIKED, DISK, XFeat

from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.keypoints import KeyPoints, enlarge, no_key_points, strongest_in_mask
from polhode.frontend.features.stereo import StereoFeatures, match_stereo, with_ranges
from polhode.frontend.peers.weights import fill, load_weights
from polhode.frontend.rectification import Image, RectifiedPair, target_crop
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Bools

SIZE_MULTIPLE_PX = 32
"""Ratio of the image to the coarsest feature maps of the networks."""
NOMINAL_SCALE_PX = 2.0
"""Scale of key points that have none: the gate of rows is then that of small ones."""
ALIKED_MODEL = "aliked-n16rot"
"""Models n16 and n16rot are one network with two sets of weights."""


class Detections(NamedTuple):
    """Key points that a network finds in one image."""

    uv_px: torch.Tensor
    """(n, 2)"""
    descriptors: torch.Tensor
    """(n, d) unit length"""
    score: torch.Tensor
    """(n,) larger is better"""


class PeerDetector:
    """``FeatureMethod``: a network's key points left and right, matched along the rows."""

    def __init__(self, config: Frontend) -> None:
        self._config = config

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Stereo measurements of one rectified pair; none when the target is out of view."""
        torch.set_num_threads(1)
        left = self._key_points(pair.left, pair.mask_left)
        if pair.measured is not None:
            return with_ranges(pair.measured, left, rig)
        right = self._key_points(pair.right, pair.mask_right)
        return match_stereo(pair.left, pair.right, left, right, rig)[0]

    def _detect(self, image: torch.Tensor) -> Detections:
        """Key points of a grey image (1, 1, H, W) from 0 to 1; H and W are multiples of 32."""
        raise NotImplementedError

    def _key_points(self, image: Image, mask: Bools) -> KeyPoints:
        """Key points of a rectified image (H, W) inside the mask, strongest first."""
        crop = target_crop(mask)
        if crop is None:
            return no_key_points()
        enlarged = enlarge(image, crop, self._config.features)
        with torch.inference_mode():
            found = self._detect(image_tensor(enlarged.image, SIZE_MULTIPLE_PX))
        uv = enlarged.in_image(found.uv_px.numpy().astype(np.float64))
        order = strongest_in_mask(uv, found.score.numpy(), mask)[: self._config.features.max_features]
        n = len(order)
        descriptors = found.descriptors.numpy()[order].astype(np.float32)
        return KeyPoints(uv[order], np.full(n, NOMINAL_SCALE_PX), np.zeros(n), descriptors)


class DiskFeatures(PeerDetector):
    """The method ``disk``."""

    def __init__(self, config: Frontend) -> None:
        super().__init__(config)
        self._network = DISK()
        fill(self._network, load_weights("disk", config.weights), "disk", config.weights)

    def _detect(self, image: torch.Tensor) -> Detections:
        found = self._network(image.expand(-1, 3, -1, -1))[0]
        return Detections(found.keypoints, found.descriptors, found.detection_scores)


class AlikedFeatures(PeerDetector):
    """The method ``aliked``."""

    def __init__(self, config: Frontend) -> None:
        super().__init__(config)
        count = 2 * config.features.max_features
        # With a threshold of zero the number of maxima is the limit.
        self._network = ALIKED(ALIKED_MODEL, max_num_keypoints=count, detection_threshold=0.0)
        fill(self._network, load_weights("aliked", config.weights), "aliked", config.weights)

    def _detect(self, image: torch.Tensor) -> Detections:
        found = self._network(image)[0]
        return Detections(found.keypoints, found.descriptors, found.keypoint_scores)


class XFeatFeatures(PeerDetector):
    """The method ``xfeat``."""

    def __init__(self, config: Frontend) -> None:
        super().__init__(config)
        self._network = XFeat(top_k=2 * config.features.max_features)
        fill(self._network.net, load_weights("xfeat", config.weights), "xfeat", config.weights)
        self._network.eval()

    def _detect(self, image: torch.Tensor) -> Detections:
        found = self._network.detectAndCompute(image)[0]
        return Detections(found["keypoints"], found["descriptors"], found["scores"])


def image_tensor(image: Image, multiple_px: int) -> torch.Tensor:
    """Grey image (H, W) as (1, 1, H', W') from 0 to 1, padded with black to multiples of ``multiple_px``."""
    height, width = (-(-side // multiple_px) * multiple_px for side in image.shape)
    padded = np.zeros((height, width), np.float32)
    padded[: image.shape[0], : image.shape[1]] = image / np.float32(255.0)
    return torch.from_numpy(padded)[None, None]
