"""Where features may be: blobs of the left image's enlarged crop, more and weaker than a matcher needs.

Difference-of-Gaussians extrema (Lowe 2004, by OpenCV). Measured on unseen bodies 30 degrees apart, half of a
low threshold's extrema have one within 1.5 px of the true place in the other frame, like those of a high
threshold, so there are simply more. Corners of the gradient matrix come as often, but scatter more.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from polhode.config.frontend import Features
from polhode.frontend.features.keypoints import stretch
from polhode.frontend.rectification.target import Image, target_crop
from polhode.lie import Array
from polhode.records import Bools

WEAKER = 0.5
"""Contrast threshold, over that of the classical method: disparity comes from elsewhere here."""
APART_PX = 0.5
"""Extrema of several scales or directions this near to one another are one place [px]."""


@dataclass(frozen=True)
class Candidates:
    """Places in one image, strongest first."""

    uv_px: Array
    """(n, 2) in the whole image"""
    scale_px: Array
    """(n,) standard deviation of the blob's Gaussian"""
    response: Array
    """(n,) contrast"""

    def __len__(self) -> int:
        return len(self.uv_px)


def find_candidates(image: Image, mask: Bools, config: Features) -> Candidates:
    """Candidates of a rectified image (H, W) inside the mask."""
    crop = target_crop(mask)
    nothing = Candidates(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    if crop is None:
        return nothing
    patch = stretch(image[crop.v0 : crop.v1, crop.u0 : crop.u1])
    zoom = float(np.clip(config.max_crop_px / max(crop.width_px, crop.height_px), 1.0, config.upsample))
    size = (round(crop.width_px * zoom), round(crop.height_px * zoom))
    zoom_uv = np.array([size[0] / crop.width_px, size[1] / crop.height_px])
    enlarged = cv2.resize(patch, size, interpolation=cv2.INTER_CUBIC) if zoom > 1.0 else patch
    sift = cv2.SIFT.create(
        nfeatures=0,
        contrastThreshold=WEAKER * config.contrast_threshold,
        edgeThreshold=12.0,
        enable_precise_upscale=True,
    )
    points = sift.detect(enlarged, None)
    if len(points) == 0:
        return nothing
    # Pixel centres are integers in both images, so the enlargement shifts by half a pixel.
    uv = (np.array([p.pt for p in points]) + 0.5) / zoom_uv - 0.5 + [crop.u0, crop.v0]
    scale = np.array([p.size for p in points]) / (2.0 * zoom_uv[0])
    response = np.array([p.response for p in points])
    pixel = np.clip(np.round(uv).astype(np.int64), 0, [image.shape[1] - 1, image.shape[0] - 1])
    order = np.argsort(-response, kind="stable")
    order = order[mask[pixel[order, 1], pixel[order, 0]]]
    cell = np.round(uv[order] / APART_PX).astype(np.int64)
    order = order[np.sort(np.unique(cell, axis=0, return_index=True)[1])][: config.max_features]
    return Candidates(uv[order], scale[order], response[order])
