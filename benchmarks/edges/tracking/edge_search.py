"""Where an image has edges near a model's control points: extrema of the gradient across the edge.

Along each normal the image is read by bilinear interpolation, averaged over a few pixels along the edge, and
convolved with the derivative of a Gaussian; extrema are placed by a parabola. A profile keeps several: which
of them is the edge is for the fit to say (Vacchetti, Lepetit and Fua, "Combining edge and texture information
for real-time accurate 3D camera tracking", ISMAR 2004: multiple hypotheses).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polhode.compiled import compiled_ieee
from polhode.lie import Array
from polhode.records import Ints

Levels = NDArray[np.float32]
"""Grey levels (H, W) of an image"""

STEP_PX = 0.5
"""Between samples of a profile."""
SMOOTHING_PX = 1.0
"""Sigma of the Gaussian."""
ALONG_PX = 2
"""The profile is the mean of those of so many pixels on both sides along the edge."""
MOST = 6
"""Candidates that a profile keeps, the strongest."""


@dataclass(frozen=True)
class EdgeCandidates:
    """Edges of the image across m control points."""

    offset_px: Array
    """(m, MOST) along the normal from the point; NaN where there are fewer"""
    contrast: Array
    """(m, MOST) step of grey levels along the normal; its sign is the direction of growing light"""


def as_levels(image: ArrayLike) -> Levels:
    """Any image of grey levels (H, W), ready to be searched."""
    return np.ascontiguousarray(image, dtype=np.float32)


def search(
    image: Levels, uv_px: Array, normal_px: Array, polarity: Ints, range_px: float, min_contrast: float
) -> EdgeCandidates:
    """Edges within range_px of points (m, 2) along normals (m, 2), of at least a contrast [grey levels].

    polarity (m,): 1 where the light must grow along the normal, -1 where it must fall, 0 where either does.
    What lies outside it gives no edge.
    """
    half = int(np.ceil(range_px / STEP_PX)) + 1
    response = np.zeros((len(uv_px), 2 * half + 1))
    _respond(image, uv_px, normal_px, _kernel(), STEP_PX, ALONG_PX, response)
    offset = np.full((len(uv_px), MOST), np.nan)
    contrast = np.zeros((len(uv_px), MOST))
    _extrema(response, polarity, STEP_PX, range_px, min_contrast, offset, contrast)
    return EdgeCandidates(offset, contrast)


def gradients(image: Levels, uv_px: Array) -> Array:
    """Gradient (m, 2) of the smoothed image at places (m, 2) [grey levels, as of a step along u or v]."""
    out = np.zeros((len(uv_px), 2, 1))
    for axis in 0, 1:
        direction = np.zeros_like(uv_px)
        direction[:, axis] = 1.0
        _respond(image, uv_px, direction, _kernel(), STEP_PX, 1, out[:, axis])
    return np.asarray(out[..., 0])


def levels(image: Levels, uv_px: Array) -> Array:
    """Grey levels (m,) at places (m, 2), by bilinear interpolation; 0 outside of the image."""
    out = np.empty(len(uv_px))
    _read(image, uv_px, out)
    return out


@compiled_ieee
def _read(image: Levels, uv: Array, out: Array) -> None:
    for k in range(len(uv)):
        out[k] = level(image, uv[k, 0], uv[k, 1])


@compiled_ieee
def level(image: Levels, u: float, v: float) -> float:
    """Grey level at one place, by bilinear interpolation; 0 outside of the image."""
    height, width = image.shape
    if not (0.0 <= u < width - 1.0 and 0.0 <= v < height - 1.0):
        return 0.0
    a, b = int(u), int(v)
    du, dv = u - a, v - b
    upper = (1.0 - du) * image[b, a] + du * image[b, a + 1]
    lower = (1.0 - du) * image[b + 1, a] + du * image[b + 1, a + 1]
    return float((1.0 - dv) * upper + dv * lower)


def _kernel() -> Array:
    """Derivative of a Gaussian, odd, such that a step of height one answers with one."""
    reach = int(np.ceil(3.0 * SMOOTHING_PX / STEP_PX))
    x = np.arange(-reach, reach + 1) * STEP_PX
    kernel = x * np.exp(-0.5 * (x / SMOOTHING_PX) ** 2)
    return np.asarray(kernel / kernel[reach + 1 :].sum())


@compiled_ieee
def _respond(
    image: Levels, uv: Array, normal: Array, kernel: Array, step: float, along: int, out: Array
) -> None:
    """Convolve the profiles (m, 2 half + 1) with the kernel; zero where one leaves the image."""
    height, width = image.shape
    reach = len(kernel) // 2
    half = out.shape[1] // 2
    profile = np.empty(2 * (half + reach) + 1)
    for i in range(len(uv)):
        nu, nv = normal[i, 0], normal[i, 1]
        for k in range(len(profile)):
            s = (k - half - reach) * step
            total = 0.0
            for t in range(-along, along + 1):
                u = uv[i, 0] + s * nu - t * nv
                v = uv[i, 1] + s * nv + t * nu
                if u < 0.0 or v < 0.0 or u >= width - 1 or v >= height - 1:
                    total = np.nan
                    break
                a, b = int(u), int(v)
                du, dv = u - a, v - b
                total += (1.0 - dv) * ((1.0 - du) * image[b, a] + du * image[b, a + 1]) + dv * (
                    (1.0 - du) * image[b + 1, a] + du * image[b + 1, a + 1]
                )
            profile[k] = total / (2 * along + 1)
        for k in range(out.shape[1]):
            answer = 0.0
            for j in range(len(kernel)):
                answer += kernel[j] * profile[k + j]
            out[i, k] = answer if answer == answer else 0.0


@compiled_ieee
def _extrema(
    response: Array, polarity: Ints, step: float, reach: float, least: float, offset: Array, contrast: Array
) -> None:
    """Keep the strongest extrema of each row, placed by a parabola."""
    most = offset.shape[1]
    half = response.shape[1] // 2
    for i in range(len(response)):
        kept = 0
        for k in range(1, response.shape[1] - 1):
            sign = 1.0 if response[i, k] > 0.0 else -1.0
            here, before, after = sign * response[i, k], sign * response[i, k - 1], sign * response[i, k + 1]
            if here < least or here < before or here <= after or polarity[i] * sign < 0.0:
                continue
            bend = before - 2.0 * here + after
            place = (k - half + 0.5 * (before - after) / bend) * step if bend < 0.0 else (k - half) * step
            if abs(place) > reach:
                continue
            slot = kept
            if kept == most:
                slot = 0
                for j in range(1, most):
                    if abs(contrast[i, j]) < abs(contrast[i, slot]):
                        slot = j
                if abs(contrast[i, slot]) >= here:
                    continue
            else:
                kept += 1
            offset[i, slot] = place
            contrast[i, slot] = sign * here
