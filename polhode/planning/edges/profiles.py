"""Profiles of grey levels across control points, and how far the edges in them are displaced.

A profile is modelled as a level and a step at each stripe (``stripes.py``), as wide as blur, pixel and stripe
make it. Heights of the steps are not known, of either sign, and found by least squares; the displacement that
all steps have in common is found by Gauss-Newton from where it is (``fitted``), or on a grid (``searched``).
What a displacement and other heights can explain alike is no information on it.

Behind the outline of a curved surface the light is not constant: the normal turns away from the line of sight
as the root of the distance, and the light with it, whatever the radius. That root has a height of its own,
without which an outline seems to lie where the surface is bright, up to half a pixel off.
"""

from dataclasses import dataclass
from math import exp, pi, sqrt

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates
from scipy.special import gammaln, ndtr, pbdv

from polhode.geometry.lie import Array, Bools
from polhode.planning.edges.stripes import (
    MAX_SHIFT_PX,
    MAX_SIGMA_PX,
    UNIFORM_SIGMA,
    MeasuredStripes,
    Stripes,
)
from polhode.planning.edges.visible_edges import ControlPoints

BLUR_PX = 0.95
"""Sigma of an edge in a profile: a lens of 0.8, a pixel, and its interpolation"""
STEP_PX = 0.5
"""Distance of the samples of a profile"""
MIN_NOISE_DN = 1.0
"""Grey levels: a profile is not believed to be better than that."""
ALONG_PX = 2
"""Pixels on both sides of a point, along the edge, over which its profile is a mean"""
_RIDGE = 1e-3
"""Of the normal equations of the heights of steps, so that equal columns do no harm"""
_ITERATIONS = 5
_LONGEST_PX, _SETTLED_PX = 0.5, 1e-4
"""Of steps of Gauss-Newton"""


@dataclass(frozen=True)
class Displacements:
    """Of the edges across m control points, from the model to the image, along the normals."""

    shift_px: Array
    """(m,)"""
    sigma_px: Array
    """(m,) by the residuals of the profile; inf where it shows nothing"""
    spread_px: Array
    """(m,) sigma of the place of the step within the stripes that give the information"""

    def of(self, stripes: Stripes, f: Array, length: Array, floor_px: Array | float) -> MeasuredStripes:
        """As measurements of motions f (m, 6), of edges that are known to ``floor_px`` at best."""
        sigma = np.hypot(self.sigma_px, floor_px)
        counts = (sigma < MAX_SIGMA_PX) & (np.abs(self.shift_px) < MAX_SHIFT_PX)
        sigma = np.where(np.isfinite(sigma), sigma, 1e3)
        return MeasuredStripes(
            stripes, f, self.shift_px, sigma, stripes.side * self.spread_px, counts, length
        )


def places(half_px: float) -> Array:
    """(n,) of the samples of a profile, along the normal of its control point."""
    count = int(np.ceil(half_px / STEP_PX))
    return np.asarray(STEP_PX * np.arange(-count, count + 1))


def blur_of(stripes: Stripes) -> Array:
    """(m, LINES) sigma of the step that each stripe makes in a profile."""
    along = np.sqrt((2 * ALONG_PX + 1) ** 2 - 1) * UNIFORM_SIGMA
    square = BLUR_PX**2 + (along * stripes.slope) ** 2 + (UNIFORM_SIGMA * stripes.width_px) ** 2
    return np.asarray(np.sqrt(square))


def fitted(place: Array, grey: Array, stripes: Stripes) -> Displacements:
    """Of the edges nearest to where the model has them, from grey levels (m, n) at places (n,)."""
    blur, lines = blur_of(stripes), stripes.offset_px.shape[1]
    shift, jj, variance = np.zeros((3, len(grey)))
    height = np.zeros(stripes.offset_px.shape)
    unknowns = 1 + np.isfinite(stripes.offset_px).sum(axis=1) + stripes.curved
    rows = np.arange(len(grey))
    for turn in range(_ITERATIONS + 1):
        # Gauss-Newton of the shift, with the heights of the steps eliminated
        A, slope = _columns(place - shift[rows, None], stripes.offset_px[rows], blur[rows])
        root, root_slope = _root_column(place - shift[rows, None], stripes.curved[rows])
        A, slope = np.concatenate([A, root], axis=2), np.concatenate([slope, root_slope], axis=2)
        At = np.swapaxes(A, 1, 2)
        N = At @ A + _RIDGE * np.eye(A.shape[2])
        h = np.linalg.solve(N, At @ grey[rows, :, None])
        j, r = slope @ h[:, 1:], grey[rows, :, None] - A @ h
        c = At @ j
        information = ((j * j).sum(axis=1) - (c * np.linalg.solve(N, c)).sum(axis=1))[:, 0]
        jj[rows] = np.maximum(information, 0.0)
        variance[rows] = (r * r).sum(axis=(1, 2)) / np.maximum(len(place) - unknowns[rows] - 1, 1)
        height[rows] = h[:, 1 : 1 + lines, 0]
        step = (j * r).sum(axis=(1, 2)) / np.where(information > 1e-9, information, np.inf)
        onward = np.abs(step) >= _SETTLED_PX
        if turn == _ITERATIONS or not onward.any():
            break
        rows, step = rows[onward], step[onward]
        shift[rows] += np.clip(step, -_LONGEST_PX, _LONGEST_PX)
    # samples are half a pixel apart, and the noise of two of them is that of one pixel
    sigma = np.sqrt(np.maximum(variance, MIN_NOISE_DN**2) / STEP_PX / np.maximum(jj, 1e-12))
    share = height**2 / np.maximum((height**2).sum(axis=1, keepdims=True), 1e-12)
    spread = np.sqrt(np.sum(share * (UNIFORM_SIGMA * np.nan_to_num(stripes.width_px)) ** 2, axis=1))
    return Displacements(shift, np.where(jj > 1e-9, sigma, np.inf), spread)


def searched(place: Array, grey: Array, stripes: Stripes, range_px: float) -> tuple[Array, Bools]:
    """The displacement (m,) within a range that explains a profile best, and whether it explains it (m,).

    Displaced by whole samples, all models of a profile are windows of one.
    """
    shifts = int(range_px / STEP_PX + 1e-9)
    longer = place[0] + STEP_PX * (np.arange(len(place) + 2 * shifts) - shifts)
    lines = max(int(np.isfinite(stripes.offset_px).sum(axis=1).max(initial=1)), 1)
    A, _ = _columns(longer[None], stripes.offset_px[:, :lines], blur_of(stripes)[:, :lines])
    # the model that is displaced least, towards lower places, begins at the end of the longest one
    windows = sliding_window_view(A, len(place), axis=1)[:, ::-1]
    b = windows @ grey[:, None, :, None]
    h = np.linalg.solve(windows @ np.swapaxes(windows, 2, 3) + _RIDGE * np.eye(1 + lines), b)
    explained = (h * b).sum(axis=(2, 3)) + _RIDGE * (h * h).sum(axis=(2, 3))
    best = np.argmax(explained, axis=1)
    left = (grey * grey).sum(axis=1) - explained[np.arange(len(grey)), best]
    spread = np.sum((grey - grey.mean(axis=1, keepdims=True)) ** 2, axis=1)
    # steps must explain 70 % of the variance
    return (best - shifts) * STEP_PX, np.asarray(left < (1.0 - 0.7) * spread)


_ROOT_AT = np.arange(-16.0, 6.01, 0.005)
_BLURRED_ROOT = exp(gammaln(1.5)) / sqrt(2.0 * pi) * np.exp(-0.25 * _ROOT_AT**2) * pbdv(-1.5, _ROOT_AT)[0]
"""The light of a curved surface grows as the root of the distance from its outline: blurred, tabulated. The
mean of the root of what is positive of a normal variable (DLMF 12.5.1)"""
_ROOT_SLOPE = np.gradient(_BLURRED_ROOT, _ROOT_AT)


def _columns(place: Array, offset: Array, blur: Array) -> tuple[Array, Array]:
    """Of places (m, n) and stripes (m, k): level and steps (m, n, 1 + k), and their slopes by the shift."""
    z = (place[..., None] - np.nan_to_num(offset)[:, None]) / np.nan_to_num(blur, nan=1.0)[:, None]
    there = np.isfinite(offset)[:, None]
    steps = np.where(there, ndtr(z), 0.0)
    slope = np.where(there, -np.exp(-0.5 * z * z) / (sqrt(2.0 * pi) * blur[:, None]), 0.0)
    return np.concatenate([np.ones((*steps.shape[:2], 1)), steps], axis=2), np.asarray(slope)


def _root_column(place: Array, curved: Bools) -> tuple[Array, Array]:
    """The same (m, n, 1) of the light behind outlines; zeros where there is none."""
    z, there = place / BLUR_PX, curved[:, None]
    root = np.where(there, np.interp(z, _ROOT_AT, _BLURRED_ROOT), 0.0)
    slope = np.where(there, -np.interp(z, _ROOT_AT, _ROOT_SLOPE) / BLUR_PX, 0.0)
    return root[..., None], slope[..., None]


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
