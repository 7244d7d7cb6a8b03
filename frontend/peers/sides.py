"""Peers that find features in one image: left and right, matched along the rows as RootSIFT is.

The target's crop is stretched and enlarged as for RootSIFT (``frontend.features``), so that methods differ in
what they find and not in what they are shown. Their key points have neither scale nor orientation.
"""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
import torch

from polhode.camera import RectifiedRig
from polhode.config.frontend import Features, Frontend
from polhode.frontend.features.keypoints import KeyPoints, no_key_points, stretch
from polhode.frontend.features.stereo import StereoFeatures, match_stereo
from polhode.frontend.rectification.rectified_pair import RectifiedPair
from polhode.frontend.rectification.target import Image, target_crop
from polhode.records import Bools

SIZE_MULTIPLE_PX = 32
"""The networks' coarsest maps are so much smaller than the image."""
NOMINAL_SCALE_PX = 2.0
"""Stands for the scale of key points that have none: the gate of rows is then that of small ones."""


@dataclass(frozen=True)
class Detections:
    """What a network finds in one image."""

    uv_px: torch.Tensor
    """(n, 2)"""
    descriptors: torch.Tensor
    """(n, d) unit length"""
    score: torch.Tensor
    """(n,) larger is better"""


class Detector(Protocol):
    """A network that finds and describes key points."""

    def __call__(self, image: torch.Tensor) -> Detections:
        """Key points of a grey image (1, 1, H, W) from 0 to 1; H and W are multiples of 32."""
        ...


def stereo_from_sides(
    detector: Detector, pair: RectifiedPair, rig: RectifiedRig, config: Frontend
) -> StereoFeatures:
    """Stereo measurements of one rectified pair; none when the target is out of sight."""
    torch.set_num_threads(1)
    left = _detect(detector, pair.left, pair.mask_left, config.features)
    right = _detect(detector, pair.right, pair.mask_right, config.features)
    return match_stereo(pair.left, pair.right, left, right, rig, config.stereo)


def _detect(detector: Detector, image: Image, mask: Bools, config: Features) -> KeyPoints:
    """Key points of a rectified image (H, W) inside the mask, strongest first."""
    crop = target_crop(mask)
    if crop is None:
        return no_key_points()
    part = stretch(image[crop.v0 : crop.v1, crop.u0 : crop.u1])
    zoom = float(np.clip(config.max_crop_px / max(part.shape), 1.0, config.upsample))
    size = (round(crop.width_px * zoom), round(crop.height_px * zoom))
    enlarged = cv2.resize(part, size, interpolation=cv2.INTER_CUBIC) if zoom > 1.0 else part
    with torch.inference_mode():
        found = detector(_tensor(np.asarray(enlarged, dtype=np.uint8)))
    zoom_uv = np.array([size[0] / crop.width_px, size[1] / crop.height_px])
    uv = (found.uv_px.numpy().astype(np.float64) + 0.5) / zoom_uv - 0.5 + [crop.u0, crop.v0]
    pixel = np.clip(np.round(uv).astype(int), 0, [image.shape[1] - 1, image.shape[0] - 1])
    order = np.argsort(-found.score.numpy(), kind="stable")
    order = order[mask[pixel[order, 1], pixel[order, 0]]][: config.max_features]
    n = len(order)
    descriptors = found.descriptors.numpy()[order].astype(np.float32)
    return KeyPoints(uv[order], np.full(n, NOMINAL_SCALE_PX), np.zeros(n), descriptors)


def _tensor(image: Image) -> torch.Tensor:
    """Grey image (H, W) as (1, 1, H', W') from 0 to 1, with black sky to the next multiple of 32."""
    height, width = (-(-side // SIZE_MULTIPLE_PX) * SIZE_MULTIPLE_PX for side in image.shape)
    padded = np.zeros((height, width), np.float32)
    padded[: image.shape[0], : image.shape[1]] = image / np.float32(255.0)
    return torch.from_numpy(padded)[None, None]
