"""Key points on the enlarged crop of the target: difference-of-Gaussians extrema (Lowe 2004, by OpenCV).

``detect`` gives key points with RootSIFT descriptors (Arandjelovic and Zisserman, "Three things everyone
should know to improve object retrieval", 2012). Enlarging the crop more than doubles the stereo matches, and
OpenCV's ``enable_precise_upscale`` removes a localization bias of a tenth of a pixel.

``find_candidates`` gives more and weaker extrema without descriptors, for surface features. On bodies that
were not trained on, 30 degrees apart, half of the extrema above a low threshold have one within 1.5 px of the
true position in the other frame, as many as above a high threshold. Corners of the gradient matrix are found
again as often, but scatter more.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.config.frontend_settings import Features
from polhode.frontend.rectification import Crop, Image, target_crop
from polhode.geometry.lie import Array, Bools, Ints

Descriptors = NDArray[np.float32]
_EDGE_THRESHOLD = 12.0


@dataclass(frozen=True)
class KeyPoints:
    """Key points of one image, strongest first."""

    uv_px: Array
    """(n, 2) in the whole image"""
    scale_px: Array
    """(n,) standard deviation of the blob's Gaussian"""
    angle_rad: Array
    """(n,) orientation"""
    descriptors: Descriptors
    """(n, d) unit length"""

    def __len__(self) -> int:
        return len(self.uv_px)


@dataclass(frozen=True)
class FeatureCandidates:
    """Positions of possible surface features in one image, strongest first."""

    uv_px: Array
    """(n, 2) in the whole image"""
    scale_px: Array
    """(n,) standard deviation of the blob's Gaussian"""
    response: Array
    """(n,) contrast"""

    def __len__(self) -> int:
        return len(self.uv_px)


def no_key_points() -> KeyPoints:
    """The key points of an image without the target."""
    return KeyPoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), dtype=np.float32))


def strongest(points: KeyPoints, count: int) -> KeyPoints:
    """The first ``count`` key points."""
    return KeyPoints(
        points.uv_px[:count], points.scale_px[:count], points.angle_rad[:count], points.descriptors[:count]
    )


def detect(image: Image, mask: Bools, crop: Crop, config: Features) -> KeyPoints:
    """RootSIFT key points of a rectified image (H, W) inside the mask, from its crop."""
    enlarged, zoom_uv = _enlarged(image, crop, config)
    points, descriptors = _sift(config.contrast_threshold).detectAndCompute(enlarged, None)
    if descriptors is None or len(points) == 0:
        return no_key_points()
    uv, scale, response = _positions(points, zoom_uv, crop)
    order = _strongest_in_mask(uv, response, mask)[: config.max_features]
    return KeyPoints(
        uv[order],
        scale[order],
        np.deg2rad([p.angle for p in points])[order],
        _root(np.asarray(descriptors, dtype=np.float32)[order]),
    )


def find_candidates(image: Image, mask: Bools, config: Features) -> FeatureCandidates:
    """Candidates of a rectified image (H, W) inside the mask."""
    none = FeatureCandidates(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    crop = target_crop(mask)
    if crop is None:
        return none
    enlarged, zoom_uv = _enlarged(image, crop, config)
    # contrast threshold of candidates, over that of ``detect``: their disparity does not come from matching
    # them
    points = _sift(0.5 * config.contrast_threshold).detect(enlarged, None)
    if len(points) == 0:
        return none
    uv, scale, response = _positions(points, zoom_uv, crop)
    order = _strongest_in_mask(uv, response, mask)
    # extrema of several scales or orientations that are this close to each other are one candidate [px]
    cell = np.round(uv[order] / 0.5).astype(np.int64)
    order = order[np.sort(np.unique(cell, axis=0, return_index=True)[1])][: config.max_features]
    return FeatureCandidates(uv[order], scale[order], response[order])


def _enlarged(image: Image, crop: Crop, config: Features) -> tuple[Image, Array]:
    """The crop of an image (H, W) with stretched contrast, enlarged as far as the configuration allows, and
    its enlargement (2,) along u and v."""
    patch = stretch(image[crop.v0 : crop.v1, crop.u0 : crop.u1])
    zoom = float(np.clip(config.max_crop_px / max(crop.width_px, crop.height_px), 1.0, config.upsample))
    size = (round(crop.width_px * zoom), round(crop.height_px * zoom))
    enlarged = cv2.resize(patch, size, interpolation=cv2.INTER_CUBIC) if zoom > 1.0 else patch
    zoom_uv = np.array([size[0] / crop.width_px, size[1] / crop.height_px])
    return np.asarray(enlarged, dtype=np.uint8), zoom_uv


def stretch(patch: Image) -> Image:
    """Spread the patch's intensities over 8 bits, so that thresholds mean the same at every exposure."""
    high = float(np.percentile(patch, 99.5))
    if high < 8.0:
        return patch
    bright: Image = np.clip(patch.astype(np.float32) * (230.0 / high), 0, 255).astype(np.uint8)
    return bright


def _strongest_in_mask(uv_px: Array, response: Array, mask: Bools) -> Ints:
    """Indices of the points (n, 2) inside the mask, strongest response (n,) first."""
    height, width = mask.shape
    pixel = np.clip(np.round(uv_px).astype(np.int64), 0, [width - 1, height - 1])
    order = np.argsort(-response, kind="stable")
    return np.asarray(order[mask[pixel[order, 1], pixel[order, 0]]])


def _sift(contrast_threshold: float) -> cv2.SIFT:
    return cv2.SIFT.create(
        nfeatures=0,
        contrastThreshold=contrast_threshold,
        edgeThreshold=_EDGE_THRESHOLD,
        enable_precise_upscale=True,
    )


def _positions(points: Sequence[cv2.KeyPoint], zoom_uv: Array, crop: Crop) -> tuple[Array, Array, Array]:
    """Positions (n, 2) and scales (n,) in the whole image [px], and responses (n,)."""
    # Pixel centres are integers in both images, so the enlargement shifts by half a pixel.
    uv = (np.array([p.pt for p in points]) + 0.5) / zoom_uv - 0.5 + [crop.u0, crop.v0]
    scale = np.array([p.size for p in points]) / (2.0 * zoom_uv[0])
    return uv, scale, np.array([p.response for p in points])


def _root(sift: NDArray[np.float32]) -> Descriptors:
    """SIFT -> RootSIFT: the square root of the L1-normalised histogram has unit length."""
    total = np.maximum(sift.sum(axis=1, keepdims=True), 1e-9)
    root: Descriptors = np.sqrt(sift / total).astype(np.float32)
    return root
