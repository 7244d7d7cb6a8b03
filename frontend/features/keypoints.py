"""Key points and descriptors: RootSIFT on the enlarged crop of the target.

RootSIFT: Arandjelovic and Zisserman, "Three things everyone should know to improve object retrieval",
2012. Enlarging the crop more than doubles the stereo matches, and OpenCV's ``enable_precise_upscale``
removes a localization bias of a tenth of a pixel.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.config.frontend import Features
from polhode.frontend.rectification.target import Crop, Image
from polhode.lie import Array
from polhode.records import Bools

Descriptors = NDArray[np.float32]


@dataclass(frozen=True)
class KeyPoints:
    """Key points of one image, strongest first."""

    uv_px: Array
    """(n, 2) in the whole image"""
    scale_px: Array
    """(n,) SIFT's scale"""
    angle_rad: Array
    """(n,) orientation"""
    descriptors: Descriptors
    """(n, 128) unit length"""

    def __len__(self) -> int:
        return len(self.uv_px)


def no_key_points() -> KeyPoints:
    """An image without the target."""
    return KeyPoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), dtype=np.float32))


def detect(image: Image, mask: Bools, crop: Crop, config: Features) -> KeyPoints:
    """RootSIFT key points of a rectified image (H, W) inside the mask, from its crop."""
    patch = stretch(image[crop.v0 : crop.v1, crop.u0 : crop.u1])
    longest = max(crop.width_px, crop.height_px)
    zoom = float(np.clip(config.max_crop_px / longest, 1.0, config.upsample))
    size = (round(crop.width_px * zoom), round(crop.height_px * zoom))
    zoom_uv = np.array([size[0] / crop.width_px, size[1] / crop.height_px])
    enlarged = cv2.resize(patch, size, interpolation=cv2.INTER_CUBIC) if zoom > 1.0 else patch
    sift = cv2.SIFT.create(
        nfeatures=0,
        contrastThreshold=config.contrast_threshold,
        edgeThreshold=12.0,
        enable_precise_upscale=True,
    )
    points, descriptors = sift.detectAndCompute(enlarged, None)
    if descriptors is None or len(points) == 0:
        return no_key_points()
    # Pixel centres are integers in both images, so the enlargement shifts by half a pixel.
    uv = (np.array([p.pt for p in points]) + 0.5) / zoom_uv - 0.5 + [crop.u0, crop.v0]
    pixel = np.clip(np.round(uv).astype(int), 0, [image.shape[1] - 1, image.shape[0] - 1])
    strength = np.array([p.response for p in points])
    order = np.argsort(-strength, kind="stable")
    order = order[mask[pixel[order, 1], pixel[order, 0]]][: config.max_features]
    return KeyPoints(
        uv[order],
        np.array([p.size for p in points])[order] / (2.0 * zoom_uv[0]),
        np.deg2rad([p.angle for p in points])[order],
        _root(np.asarray(descriptors)[order]),
    )


def stretch(patch: Image) -> Image:
    """Spread the patch's intensities over 8 bits, so that thresholds mean the same at every exposure."""
    high = float(np.percentile(patch, 99.5))
    if high < 8.0:
        return patch
    bright: Image = np.clip(patch.astype(np.float32) * (230.0 / high), 0, 255).astype(np.uint8)
    return bright


def _root(sift: NDArray[np.float32]) -> Descriptors:
    """SIFT -> RootSIFT: the square root of the L1-normalised histogram has unit length."""
    total = np.maximum(sift.sum(axis=1, keepdims=True), 1e-9)
    root: Descriptors = np.sqrt(sift / total).astype(np.float32)
    return root
