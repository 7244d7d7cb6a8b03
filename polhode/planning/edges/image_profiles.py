"""What an image shows across control points: profiles of grey levels, and extrema of the gradient.

Along each normal the image is read by bilinear interpolation and averaged over a few pixels along the edge.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from polhode.geometry.lie import Array
from polhode.planning.edges.stripe_profiles import ALONG_PX, STEP_PX, places
from polhode.planning.edges.visible_edges import ControlPoints

Levels = NDArray[np.float32]
"""Grey levels (H, W) of an image"""

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
    return place, _read(image, points, place, 0.0)


def gradient_extrema(image: Levels, points: ControlPoints, range_px: float, min_contrast: float) -> Array:
    """Places (m, MAX_CANDIDATES) of edges within a range along the normals [px]; NaN where there are fewer.

    ``min_contrast``: least step of grey levels. A profile that leaves the image has no edge there.
    """
    reach = int(np.ceil(3.0 * SMOOTHING_PX / STEP_PX))
    x = np.arange(-reach, reach + 1) * STEP_PX
    kernel = x * np.exp(-0.5 * (x / SMOOTHING_PX) ** 2)
    # a step of height one answers with one
    kernel /= kernel[reach + 1 :].sum()
    side = int(np.ceil(range_px / STEP_PX)) + 1
    offset = np.asarray(STEP_PX * np.arange(-side - reach, side + reach + 1), dtype=np.float64)
    grey = _read(image, points, offset, np.nan)
    response = np.nan_to_num(sliding_window_view(grey, len(kernel), axis=1) @ kernel)
    here = np.abs(response[:, 1:-1])
    before, after = (np.sign(response[:, 1:-1]) * each for each in (response[:, :-2], response[:, 2:]))
    # located by a parabola
    bend = before - 2.0 * here + after
    offset = np.divide(0.5 * (before - after), bend, out=np.zeros_like(bend), where=bend < 0.0)
    place = (np.arange(1 - side, side) + offset) * STEP_PX
    good = (here >= min_contrast) & (here >= before) & (here > after) & (np.abs(place) <= range_px)
    strongest = np.argsort(np.where(good, -here, 0.0), axis=1, kind="stable")[:, :MAX_CANDIDATES]
    found = np.take_along_axis(np.where(good, place, np.nan), strongest, axis=1)
    missing = MAX_CANDIDATES - found.shape[1]
    return np.asarray(np.pad(found, ((0, 0), (0, max(missing, 0))), constant_values=np.nan))


def _read(image: Levels, points: ControlPoints, place: Array, outside: float) -> Array:
    """Means (m, n) over 2 ALONG_PX + 1 pixels along the edges at places (n,) along the normals."""
    normal, along = points.normal_px, np.arange(-ALONG_PX, ALONG_PX + 1.0)
    across_uv = points.uv_px[:, None] + place[:, None] * normal[:, None]
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    u, v = np.moveaxis(across_uv[:, :, None] + along[:, None] * tangent[:, None, None], -1, 0)
    read = map_coordinates(image, [v, u], np.float64, order=1, mode="constant", cval=outside)
    return np.asarray(read.mean(axis=2))
