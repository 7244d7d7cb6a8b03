"""How far an image shows the edges across a control point displaced, all of them together.

Along the normal of the point the image is read as in ``edge_search.py``. The profile is modelled as a level
and a step at each stripe (``planning/edges/stripes.py``), as wide as blur, pixel and stripe make it. Heights
of the steps are not known, of either sign, and found by least squares; the displacement that all steps have
in common is found by Gauss-Newton from where it is (``displacement``), or on a grid (``searched``). What a
displacement and other heights can explain alike is no information on it.
"""

from dataclasses import dataclass
from math import erf, exp, pi, sqrt

import numpy as np

from benchmarks.edges.tracking.edge_search import ALONG_PX, Levels, levels
from polhode.compiled import compiled_ieee
from polhode.lie import Array
from polhode.planning.edges.stripes import BLUR_PX, LINES, RIDGE, STEP_PX, UNIFORM, Stripes
from polhode.planning.edges.visible_edges import ControlPoints
from polhode.records import Bools

LEAST_NOISE = 1.0
"""Grey levels: a profile is not believed to be better than that."""
STEPS = 5
EXPLAINED = 0.7
"""Share of a profile's variance that its steps must explain where they are searched"""


@dataclass(frozen=True)
class Displacements:
    """Of the edges across m control points, from the model to the image, along the normals."""

    shift_px: Array
    """(m,)"""
    sigma_px: Array
    """(m,) by the residuals of the profile; inf where it shows nothing"""
    spread_px: Array
    """(m,) sigma of the place of the step within the stripes that give the information"""


def profiles(image: Levels, points: ControlPoints, half_px: float) -> tuple[Array, Array]:
    """Places (n,) along the normals and grey levels (m, n) there, averaged along the edge."""
    count = int(np.ceil(half_px / STEP_PX))
    place = STEP_PX * np.arange(-count, count + 1)
    along = np.arange(-ALONG_PX, ALONG_PX + 1)
    normal = points.normal_px
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    uv = points.uv_px[:, None, None] + place[None, :, None, None] * normal[:, None, None]
    uv = uv + along[None, None, :, None] * tangent[:, None, None]
    grey = levels(image, uv.reshape(-1, 2)).reshape(len(points), len(place), len(along))
    return place, np.asarray(grey.mean(axis=2))


def blur_of(stripes: Stripes) -> Array:
    """(m, LINES) sigma of the step that each stripe makes in a profile."""
    along = np.sqrt((2 * ALONG_PX + 1) ** 2 - 1) * UNIFORM
    return np.sqrt(BLUR_PX**2 + (along * stripes.slope) ** 2 + (UNIFORM * stripes.width_px) ** 2)


def displacement(image: Levels, points: ControlPoints, stripes: Stripes, half_px: float) -> Displacements:
    """Of the edges nearest to where the model has them."""
    place, grey = profiles(image, points, half_px)
    shift = np.zeros(len(points))
    told = np.zeros((len(points), 2))
    height = np.zeros((len(points), LINES))
    _descend(place, grey, stripes.offset_px, blur_of(stripes), STEPS, shift, told, height)
    noise = np.maximum(told[:, 1], LEAST_NOISE**2)
    # samples are half a pixel apart, and the noise of two of them is that of one pixel
    sigma = np.sqrt(noise / STEP_PX / np.maximum(told[:, 0], 1e-12))
    square = height**2
    share = square / np.maximum(square.sum(axis=1, keepdims=True), 1e-12)
    spread = np.sqrt(np.nansum(share * (UNIFORM * np.nan_to_num(stripes.width_px)) ** 2, axis=1))
    return Displacements(shift, np.where(told[:, 0] > 1e-9, sigma, np.inf), spread)


def searched(image: Levels, points: ControlPoints, stripes: Stripes, range_px: float) -> tuple[Array, Bools]:
    """The displacement (m,) within a range that explains a profile best, and whether it explains it (m,)."""
    place, grey = profiles(image, points, range_px + 1.5)
    shifts = np.arange(-range_px, range_px + 1e-9, STEP_PX)
    best, left = np.zeros(len(points)), np.zeros(len(points))
    _scan(place, grey, stripes.offset_px, blur_of(stripes), shifts, best, left)
    spread = np.sum((grey - grey.mean(axis=1, keepdims=True)) ** 2, axis=1)
    return best, np.asarray(left < (1.0 - EXPLAINED) * spread)


@compiled_ieee
def _columns(place: Array, offset: Array, blur: Array, shift: float, A: Array, slope: Array) -> int:
    """Columns of the model (n, 1 + LINES) and their derivatives by the shift; returns how many there are."""
    lines = 0
    for k in range(len(offset)):
        if offset[k] != offset[k]:
            break
        lines += 1
        for n in range(len(place)):
            z = (place[n] - offset[k] - shift) / blur[k]
            A[n, 1 + k] = 0.5 * (1.0 + erf(z / sqrt(2.0)))
            slope[n, k] = -exp(-0.5 * z * z) / (sqrt(2.0 * pi) * blur[k])
    return 1 + lines


@compiled_ieee
def _factor(A: Array, columns: int, L: Array) -> None:
    """Cholesky factor of A^T A with a ridge."""
    for i in range(columns):
        for j in range(i + 1):
            total = RIDGE if i == j else 0.0
            for n in range(len(A)):
                total += A[n, i] * A[n, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = sqrt(total) if i == j else total / L[j, j]


@compiled_ieee
def _solve(L: Array, columns: int, right: Array) -> None:
    """Replace the right side by the solution."""
    for i in range(columns):
        for k in range(i):
            right[i] -= L[i, k] * right[k]
        right[i] /= L[i, i]
    for i in range(columns - 1, -1, -1):
        for k in range(i + 1, columns):
            right[i] -= L[k, i] * right[k]
        right[i] /= L[i, i]


@compiled_ieee
def _heights(A: Array, columns: int, grey: Array, L: Array, h: Array) -> None:
    """The level and the heights of the steps (columns,) of least squares, and the factor that gave them."""
    _factor(A, columns, L)
    for k in range(columns):
        h[k] = 0.0
        for n in range(len(A)):
            h[k] += A[n, k] * grey[n]
    _solve(L, columns, h)


@compiled_ieee
def _descend(
    place: Array,
    grey: Array,
    offset: Array,
    blur: Array,
    steps: int,
    shift: Array,
    told: Array,
    height: Array,
) -> None:
    """Gauss-Newton of the shift, with the heights eliminated; told: information and variance."""
    count = len(place)
    A = np.ones((count, 1 + offset.shape[1]))
    slope = np.zeros((count, offset.shape[1]))
    L = np.zeros((A.shape[1], A.shape[1]))
    h, c = np.zeros(A.shape[1]), np.zeros(A.shape[1])
    j = np.zeros(count)
    for i in range(len(grey)):
        for turn in range(steps + 1):
            columns = _columns(place, offset[i], blur[i], shift[i], A, slope)
            _heights(A, columns, grey[i], L, h)
            jj, jr, rr = 0.0, 0.0, 0.0
            c[:] = 0.0
            for n in range(count):
                fitted = h[0]
                j[n] = 0.0
                for k in range(1, columns):
                    fitted += h[k] * A[n, k]
                    j[n] += h[k] * slope[n, k - 1]
                r = grey[i, n] - fitted
                jj += j[n] * j[n]
                jr += j[n] * r
                rr += r * r
                for k in range(columns):
                    c[k] += A[n, k] * j[n]
            d = c.copy()
            _solve(L, columns, d)
            for k in range(columns):
                jj -= c[k] * d[k]
            told[i, 0], told[i, 1] = max(jj, 0.0), rr / max(count - columns - 1, 1)
            if turn < steps and jj > 1e-9:
                step = jr / jj
                shift[i] += min(max(step, -0.5), 0.5)
        for k in range(height.shape[1]):
            height[i, k] = h[1 + k] if 1 + k < columns else 0.0


@compiled_ieee
def _scan(
    place: Array, grey: Array, offset: Array, blur: Array, shifts: Array, best: Array, left: Array
) -> None:
    """The shift of least squares."""
    count = len(place)
    A = np.ones((count, 1 + offset.shape[1]))
    slope = np.zeros((count, offset.shape[1]))
    L = np.zeros((A.shape[1], A.shape[1]))
    h = np.zeros(A.shape[1])
    for i in range(len(grey)):
        left[i] = np.inf
        for s in range(len(shifts)):
            columns = _columns(place, offset[i], blur[i], shifts[s], A, slope)
            _heights(A, columns, grey[i], L, h)
            total = 0.0
            for n in range(count):
                r = grey[i, n] - h[0]
                for k in range(1, columns):
                    r -= h[k] * A[n, k]
                total += r * r
            if total < left[i]:
                left[i], best[i] = total, shifts[s]
