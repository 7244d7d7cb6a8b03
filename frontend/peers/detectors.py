"""Published detectors and descriptors (by Kornia) as feature methods: DISK, ALIKED and XFeat.

Each finds key points in the left and in the right image; these are matched along the rows as for RootSIFT.
The crop of the target is stretched and enlarged as for RootSIFT, so that the methods differ in what they
find, not in their input. Their key points have neither scale nor orientation.

DISK: Tyszkiewicz, Fua and Trulls, "DISK: Learning local features with policy gradient", 2020. ALIKED: Zhao et
al., "ALIKED: A lighter keypoint and descriptor extraction network", 2023. XFeat: Potje et al., "XFeat:
Accelerated features for lightweight image matching", 2024.
"""

import numpy as np
import torch
from kornia.feature import ALIKED, DISK, XFeat

from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.keypoints import KeyPoints, enlarge, no_key_points, strongest_in_mask
from polhode.frontend.features.stereo import StereoFeatures, match_stereo, with_ranges
from polhode.frontend.peers.weights import fill
from polhode.frontend.rectification import Image, RectifiedPair, target_crop
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Bools

SIZE_MULTIPLE_PX = 32
"""Ratio of the image to the coarsest feature maps of the networks."""
NOMINAL_SCALE_PX = 2.0
"""Scale of key points that have none: the gate of rows is then that of small ones."""
ALIKED_MODEL = "aliked-n16rot"
"""Models n16 and n16rot are one network with two sets of weights."""


class PeerDetector:
    """``FeatureMethod``: a network's key points left and right, matched along the rows."""

    def __init__(self, config: Frontend) -> None:
        self._features, count = config.features, 2 * config.features.max_features
        self._network: torch.nn.Module
        if self._features.method == "disk":
            self._network = DISK()
        elif self._features.method == "aliked":
            # With a threshold of zero the number of maxima is the limit.
            self._network = ALIKED(ALIKED_MODEL, max_num_keypoints=count, detection_threshold=0.0)
        else:
            self._network = XFeat(top_k=count)
        own = self._network.net if isinstance(self._network, XFeat) else self._network
        fill(own, self._features.method, config.weights)
        self._network.eval()

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Stereo measurements of one rectified pair; none when the target is out of view."""
        torch.set_num_threads(1)
        left = self._key_points(pair.left, pair.mask_left)
        if pair.measured is not None:
            return with_ranges(pair.measured, left, rig)
        right = self._key_points(pair.right, pair.mask_right)
        return match_stereo(pair.left, pair.right, left, right, rig)[0]

    def _key_points(self, image: Image, mask: Bools) -> KeyPoints:
        """Key points of a rectified image (H, W) inside the mask, strongest first."""
        crop = target_crop(mask)
        if crop is None:
            return no_key_points()
        enlarged = enlarge(image, crop, self._features)
        given = image_tensor(enlarged.image, SIZE_MULTIPLE_PX)
        with torch.inference_mode():
            if isinstance(self._network, XFeat):
                seen = self._network.detectAndCompute(given)[0]
                found = seen["keypoints"], seen["descriptors"], seen["scores"]
            elif isinstance(self._network, DISK):
                disk = self._network(given.expand(-1, 3, -1, -1))[0]
                found = disk.keypoints, disk.descriptors, disk.detection_scores
            else:
                aliked = self._network(given)[0]
                found = aliked.keypoints, aliked.descriptors, aliked.keypoint_scores
        places, descriptors, score = (each.numpy() for each in found)
        uv = enlarged.in_image(places.astype(np.float64))
        order = strongest_in_mask(uv, score, mask)[: self._features.max_features]
        scale, angle = np.full(len(order), NOMINAL_SCALE_PX), np.zeros(len(order))
        return KeyPoints(uv[order], scale, angle, descriptors[order].astype(np.float32))


def image_tensor(image: Image, multiple_px: int) -> torch.Tensor:
    """Grey image (H, W) as (1, 1, H', W') from 0 to 1, padded with black to multiples of ``multiple_px``."""
    height, width = (-(-side // multiple_px) * multiple_px for side in image.shape)
    padded = np.zeros((height, width), np.float32)
    padded[: image.shape[0], : image.shape[1]] = image / np.float32(255.0)
    return torch.from_numpy(padded)[None, None]
