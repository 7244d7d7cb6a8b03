"""What an image shows across control points: profiles of grey levels, and extrema of the gradient.

Along each normal the image is read by bilinear interpolation and averaged over a few pixels along the edge.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polhode.geometry.lie import Array
from polhode.planning.edges.stripe_profiles import ALONG_PX, places
from polhode.planning.edges.visible_edges import ControlPoints
from polhode.runtime.compiled import compiled_ieee

Levels = NDArray[np.float32]
"""Grey levels (H, W) of an image"""

STEP_PX = 0.5
"""Between samples of a profile whose gradient is searched"""
SMOOTHING_PX = 1.0
"""Sigma of the Gaussian whose derivative gives the gradient"""
MAX_CANDIDATES = 6
"""Extrema that a profile keeps, the strongest"""


def as_levels(image: ArrayLike) -> Levels:
    """Any image of grey levels (H, W), ready to be read."""
    return np.ascontiguousarray(image, dtype=np.float32)


def profiles(image: Levels, points: ControlPoints, half_px: float) -> tuple[Array, Array]:
    """Places (n,) along the normals of m points and grey levels (m, n) there; 0 outside of the image."""
    place = places(half_px)
    grey = np.empty((len(points), len(place)))
    _read(image, points.uv_px, points.normal_px, place, 0.0, grey)
    return place, grey


def gradient_extrema(image: Levels, points: ControlPoints, range_px: float, min_contrast: float) -> Array:
    """Places (m, MAX_CANDIDATES) of edges within a range along the normals [px]; NaN where there are fewer.

    ``min_contrast``: least step of grey levels. A profile that leaves the image has no edge there.
    """
    reach = int(np.ceil(3.0 * SMOOTHING_PX / STEP_PX))
    x = np.arange(-reach, reach + 1) * STEP_PX
    kernel = x * np.exp(-0.5 * (x / SMOOTHING_PX) ** 2)
    # a step of height one answers with one
    kernel /= kernel[reach + 1 :].sum()
    half = int(np.ceil(range_px / STEP_PX)) + 1 + reach
    grey = np.empty((len(points), 2 * half + 1))
    offset = np.asarray(STEP_PX * np.arange(-half, half + 1), dtype=np.float64)
    _read(image, points.uv_px, points.normal_px, offset, np.nan, grey)
    place = np.full((len(points), MAX_CANDIDATES), np.nan)
    _find_extrema(grey, kernel, range_px, min_contrast, place)
    return place


@compiled_ieee
def _read(image: Levels, uv: Array, normal: Array, place: Array, outside: float, out: Array) -> None:
    """Means over 2 ALONG_PX + 1 pixels along the edges, by bilinear interpolation."""
    height, width = image.shape
    for i in range(len(uv)):
        nu, nv = normal[i, 0], normal[i, 1]
        for k in range(len(place)):
            total = 0.0
            for along in range(-ALONG_PX, ALONG_PX + 1):
                u = uv[i, 0] + place[k] * nu - along * nv
                v = uv[i, 1] + place[k] * nv + along * nu
                if not (0.0 <= u < width - 1.0 and 0.0 <= v < height - 1.0):
                    total += outside
                    continue
                a, b = int(u), int(v)
                du, dv = u - a, v - b
                upper = (1.0 - du) * image[b, a] + du * image[b, a + 1]
                lower = (1.0 - du) * image[b + 1, a] + du * image[b + 1, a + 1]
                total += (1.0 - dv) * upper + dv * lower
            out[i, k] = total / (2 * ALONG_PX + 1)


@compiled_ieee
def _find_extrema(grey: Array, kernel: Array, range_px: float, least: float, place: Array) -> None:
    """Fill the places of the strongest extrema of the convolved profiles, located by a parabola."""
    count = grey.shape[1] - len(kernel) + 1
    response, strength = np.empty(count), np.zeros(place.shape[1])
    for i in range(len(grey)):
        for k in range(count):
            answer = 0.0
            for j in range(len(kernel)):
                answer += kernel[j] * grey[i, k + j]
            response[k] = answer if answer == answer else 0.0
        found = 0
        for k in range(1, count - 1):
            sign = 1.0 if response[k] > 0.0 else -1.0
            here, before, after = sign * response[k], sign * response[k - 1], sign * response[k + 1]
            if here < least or here < before or here <= after:
                continue
            bend = before - 2.0 * here + after
            at = (k - count // 2 + (0.5 * (before - after) / bend if bend < 0.0 else 0.0)) * STEP_PX
            if abs(at) > range_px:
                continue
            slot = found if found < len(strength) else np.argmin(strength)
            if found == len(strength) and strength[slot] >= here:
                continue
            found = min(found + 1, len(strength))
            place[i, slot], strength[slot] = at, here
