"""What one image shows of exposure, focus, noise, and of what surrounds the target; what its ranges show."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.frontend.rectification import Image, MeasuredDisparity, target_crop
from polhode.frontend.segmentation import border_of, sky_level, target_mask
from polhode.geometry.lie import Bools

SATURATED = 254
"""Grey levels of 8 bits from which on a pixel is taken as saturated."""
REBLUR_PX = 1.0
"""Standard deviation of the Gaussian that the image is blurred with once more."""
CLEAR_EDGE = 12.0
"""Least gradient of an edge that counts, in standard deviations of the gradient of noise."""
DIRECTIONS = 4
NOISE_OF_GRADIENT = float(np.sqrt(12.0) / 8.0)
"""Of Sobel's derivative along one axis, for noise of one grey level."""
NO_PLANE = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0])
"""A mask that annuls planes; its squares add up to 36 (Immerkaer, "Fast noise variance estimation", 1996)."""
NAN = float("nan")


@dataclass(frozen=True)
class ImageQuality:
    """Numbers of one image as recorded, not rectified; NaN where the image does not show it."""

    target_share: float
    """Of the image's pixels that are target."""
    touches_border: bool
    """Whether the target reaches the border of the image"""
    border_bright: float
    """Share of the image's border that is brighter than the sky"""
    around_bright: float
    """Share of the pixels outside the target that are brighter than the sky"""
    extent_px: tuple[float, float] = (0.0, 0.0)
    """Width and height of the target's bounding box; 0: the target is not seen"""
    saturated: float = NAN
    """Share of the target's pixels"""
    bright_level: float = NAN
    """99.5th percentile of the grey levels of the target: what feature detection stretches to full scale"""
    noise: float = NAN
    """Standard deviation of the noise on the target [grey levels]"""
    edge_px: float = NAN
    """Median width of the edges: standard deviation of the Gaussian that blurs them, with the 0.6 px of the
    derivative [px]"""
    edge_by_direction_px: tuple[float, ...] = (NAN,) * DIRECTIONS
    """The same for edges whose gradient points along 0, 45, 90 and 135 degrees; NaN: too few edges"""


def image_quality(image: Image, given: Bools | None, surroundings: bool = False) -> ImageQuality:
    """Judge an image (H, W) with its given mask (H, W), if any.

    surroundings: whether dim surroundings are left out of the target's mask.
    """
    edge = border_of(np.ones(image.shape, dtype=np.bool_))
    mask = target_mask(image, given, edge if surroundings else None)
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 1.5), dtype=np.uint8)
    bright = smooth > sky_level(smooth)
    around = ~(cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0)
    quality = ImageQuality(
        target_share=float(mask.mean()),
        touches_border=bool(mask[edge].any()),
        border_bright=float(bright[edge].mean()),
        around_bright=float(bright[around].mean()) if around.any() else NAN,
    )
    crop = target_crop(mask, margin_px=0)
    if crop is None:
        return quality
    part = image[crop.v0 : crop.v1, crop.u0 : crop.u1]
    inside = mask[crop.v0 : crop.v1, crop.u0 : crop.u1]
    noise = noise_level(part, inside)
    width_px, by_direction_px = edge_widths(part, inside, noise)
    return replace(
        quality,
        extent_px=(float(crop.width_px), float(crop.height_px)),
        saturated=float(np.mean(part[inside] >= SATURATED)),
        bright_level=float(np.percentile(part[inside], 99.5)),
        noise=noise,
        edge_px=width_px,
        edge_by_direction_px=by_direction_px,
    )


def noise_level(image: Image, inside: Bools) -> float:
    """Standard deviation of the noise [grey levels], by the flattest blocks of the target (H, W).

    In each block the mean magnitude of what is no plane; of the blocks the lowest decile, where texture adds
    least. NaN: the target is too small, or saturated.
    """
    n = 8
    rows, columns = (size // n for size in image.shape)
    if min(rows, columns) == 0:
        return NAN

    def blocks(values: NDArray[Any]) -> NDArray[Any]:
        cut = values[: rows * n, : columns * n].reshape(rows, n, columns, n)
        return np.asarray(cut.transpose(0, 2, 1, 3).reshape(rows * columns, n * n))

    response = np.abs(np.asarray(cv2.filter2D(image.astype(np.float32), -1, NO_PLANE)))
    whole = blocks(inside & (image < SATURATED) & (image > 2)).all(axis=1)
    if whole.sum() < 5:
        return NAN
    sigma = np.sqrt(np.pi / 2.0) / 6.0 * blocks(response)[whole].mean(axis=1)
    return float(np.percentile(sigma, 10.0))


def edge_widths(image: Image, inside: Bools, noise: float) -> tuple[float, tuple[float, ...]]:
    """Median width of the edges [px], of all and by direction of their gradient.

    An edge that is blurred once more, by a known Gaussian, loses the more of its gradient the sharper it
    was (Zhuo and Sim, "Defocus map estimation from a single image", 2011). Saturated ones do not count.
    """
    values = image.astype(np.float32)
    again = np.asarray(cv2.GaussianBlur(values, (0, 0), REBLUR_PX), np.float32)
    (gx, gy), gradient_again = (
        [np.asarray(cv2.Sobel(z, cv2.CV_32F, *d, scale=0.125), np.float32) for d in ((1, 0), (0, 1))]
        for z in (values, again)
    )
    size, size_again = np.hypot(gx, gy), np.hypot(*gradient_again)
    clear = max(CLEAR_EDGE * (noise if np.isfinite(noise) else 1.0) * NOISE_OF_GRADIENT, 2.0)
    saturated = cv2.dilate((image >= SATURATED).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    edge = (size > clear) & inside & ~saturated
    # where the gradient is largest along its own direction
    v, u = np.indices(size.shape).astype(np.float32)
    scale = np.maximum(size, 1e-6)
    for sign in (-1.0, 1.0):
        u1, v1 = ((at + sign * g / scale).astype(np.float32) for at, g in ((u, gx), (v, gy)))
        edge &= size >= cv2.remap(size, u1, v1, cv2.INTER_LINEAR)
    ratio = size[edge] / np.maximum(size_again[edge], 1e-6)
    width = REBLUR_PX / np.sqrt(np.maximum(ratio**2 - 1.0, 1e-2))
    angle = np.arctan2(gy[edge], gx[edge]) % np.pi
    sector = np.round(angle / (np.pi / DIRECTIONS)).astype(np.int64) % DIRECTIONS

    def median(part: NDArray[Any]) -> float:
        return float(np.median(part)) if len(part) >= 40 else NAN

    return median(width), tuple(median(width[sector == k]) for k in range(DIRECTIONS))


@dataclass(frozen=True)
class RangeQuality:
    """Of the range image of one frame, instead of a second camera."""

    missing: float
    """Share of the target's pixels without a measurement; NaN: there is no target"""
    noise_ratio: float
    """Scatter of single pixels about planes, over what is stated; NaN: too few"""


def range_quality(measured: MeasuredDisparity, target: Bools) -> RangeQuality:
    """What the ranges of one frame show on the target (H, W); the scatter is a median, which edges do not
    move."""
    if not target.any():
        return RangeQuality(NAN, NAN)
    known = target & np.isfinite(measured.disparity_px)
    response = cv2.filter2D(np.where(known, measured.disparity_px, 0.0).astype(np.float64), -1, NO_PLANE)
    whole, ratio = cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0, NAN
    if whole.sum() >= 50:
        scatter = np.abs(np.asarray(response)[whole]) / 6.0 / measured.sigma_px[whole]
        # half of a normal law is within 0.6745 sigmas
        ratio = float(np.median(scatter)) / 0.6745
    return RangeQuality(float(1.0 - known.sum() / target.sum()), ratio)
