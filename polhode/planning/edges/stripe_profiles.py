"""How far the edges across a control point are displaced in a profile of grey levels, all of them together.

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
from scipy.special import gammaln, ndtr, pbdv

from polhode.geometry.lie import Array, Bools
from polhode.planning.edges.stripes import (
    MAX_SHIFT_PX,
    MAX_SIGMA_PX,
    UNIFORM_SIGMA,
    MeasuredStripes,
    Stripes,
)
from polhode.runtime.compiled import compiled_ieee

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
_NO_SIGMA_PX = 1e3
"""Of a point that shows nothing, in place of infinity"""
_EXPLAINED = 0.7
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

    def of(self, stripes: Stripes, f: Array, length: Array, floor_px: Array | float) -> MeasuredStripes:
        """As measurements of motions f (m, 6), of edges that are known to ``floor_px`` at best."""
        sigma = np.hypot(self.sigma_px, floor_px)
        counts = (sigma < MAX_SIGMA_PX) & (np.abs(self.shift_px) < MAX_SHIFT_PX)
        sigma = np.where(np.isfinite(sigma), sigma, _NO_SIGMA_PX)
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
    shift = np.zeros(len(grey))
    information = np.zeros((len(grey), 2))
    height = np.zeros(stripes.offset_px.shape)
    _descend(
        place,
        grey,
        stripes.offset_px,
        blur_of(stripes),
        stripes.curved,
        _ITERATIONS,
        _BLURRED_STEP,
        _BLURRED_ROOT,
        shift,
        information,
        height,
    )
    noise = np.maximum(information[:, 1], MIN_NOISE_DN**2)
    # samples are half a pixel apart, and the noise of two of them is that of one pixel
    sigma = np.sqrt(noise / STEP_PX / np.maximum(information[:, 0], 1e-12))
    square = height**2
    share = square / np.maximum(square.sum(axis=1, keepdims=True), 1e-12)
    spread = np.sqrt(np.nansum(share * (UNIFORM_SIGMA * np.nan_to_num(stripes.width_px)) ** 2, axis=1))
    return Displacements(shift, np.where(information[:, 0] > 1e-9, sigma, np.inf), spread)


def searched(place: Array, grey: Array, stripes: Stripes, range_px: float) -> tuple[Array, Bools]:
    """The displacement (m,) within a range that explains a profile best, and whether it explains it (m,)."""
    shifts = int(range_px / STEP_PX + 1e-9)
    best, left = np.zeros(len(grey)), np.zeros(len(grey))
    _scan(place, grey, stripes.offset_px, blur_of(stripes), shifts, _BLURRED_STEP, best, left)
    spread = np.sum((grey - grey.mean(axis=1, keepdims=True)) ** 2, axis=1)
    return best, np.asarray(left < (1.0 - _EXPLAINED) * spread)


_PER_SIGMA, _SIGMAS = 200, 6
_BLURRED_STEP = ndtr(np.arange(-_PER_SIGMA * _SIGMAS, _PER_SIGMA * _SIGMAS + 2) / _PER_SIGMA)
"""A blurred step of light of height 1, tabulated: linear in between, it errs by less than 1e-6"""


_ROOT_FROM, _ROOT_TO = -16, 6
_ROOT_AT = np.arange(_ROOT_FROM * _PER_SIGMA, _ROOT_TO * _PER_SIGMA + 2) / _PER_SIGMA
_BLURRED_ROOT = exp(gammaln(1.5)) / sqrt(2.0 * pi) * np.exp(-0.25 * _ROOT_AT**2) * pbdv(-1.5, _ROOT_AT)[0]
"""The light of a curved surface grows as the root of the distance from its outline: blurred, tabulated. The
mean of the root of what is positive of a normal variable (DLMF 12.5.1)"""


@compiled_ieee
def _blurred_root(z: float, table: Array) -> tuple[float, float]:
    """Root of the distance behind an outline, z sigmas before it, blurred; and its derivative."""
    at = (z - _ROOT_FROM) * _PER_SIGMA
    below = min(max(int(at), 0), len(table) - 2)
    slope = table[below + 1] - table[below]
    return float(table[below] + (at - below) * slope), float(slope * _PER_SIGMA)


@compiled_ieee
def _blurred_step(z: float, table: Array) -> float:
    """A blurred step of light of height 1, z sigmas from it."""
    at = (z + _SIGMAS) * _PER_SIGMA
    if at <= 0.0:
        return 0.0
    if at >= len(table) - 1:
        return 1.0
    below = int(at)
    return float(table[below] + (at - below) * (table[below + 1] - table[below]))


@compiled_ieee
def _columns(
    place: Array,
    offset: Array,
    blur: Array,
    curved: bool,
    shift: float,
    table: Array,
    root_table: Array,
    A: Array,
    slope: Array,
) -> int:
    """Columns of the model (n, 2 + LINES) and their derivatives by the shift; returns how many there are."""
    lines = 0
    for k in range(len(offset)):
        if offset[k] != offset[k]:
            break
        lines += 1
        for n in range(len(place)):
            z = (place[n] - offset[k] - shift) / blur[k]
            A[n, 1 + k] = _blurred_step(z, table)
            slope[n, k] = -exp(-0.5 * z * z) / (sqrt(2.0 * pi) * blur[k])
    if not curved:
        return 1 + lines
    for n in range(len(place)):
        z = (place[n] - shift) / BLUR_PX
        A[n, 1 + lines], along = _blurred_root(z, root_table)
        slope[n, lines] = -along / BLUR_PX
    return 2 + lines


@compiled_ieee
def _factor(N: Array, columns: int, L: Array) -> None:
    """Cholesky factor of N (columns, columns), lower."""
    for i in range(columns):
        for j in range(i + 1):
            total = N[i, j]
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
def _normal_matrix(A: Array, columns: int, N: Array) -> None:
    """A^T A with a ridge, lower."""
    N[:columns, :columns] = 0.0
    for i in range(columns):
        N[i, i] = _RIDGE
    # the innermost loop runs along the rows of both
    for n in range(len(A)):
        for i in range(columns):
            for j in range(i + 1):
                N[i, j] += A[n, i] * A[n, j]


@compiled_ieee
def _descend(
    place: Array,
    grey: Array,
    offset: Array,
    blur: Array,
    curved: Bools,
    steps: int,
    table: Array,
    root_table: Array,
    shift: Array,
    information: Array,
    height: Array,
) -> None:
    """Gauss-Newton of the shift, with the heights eliminated; information: information and variance."""
    count = len(place)
    A = np.ones((count, 2 + offset.shape[1]))
    slope = np.zeros((count, 1 + offset.shape[1]))
    N, L = np.zeros((A.shape[1], A.shape[1])), np.zeros((A.shape[1], A.shape[1]))
    h, c = np.zeros(A.shape[1]), np.zeros(A.shape[1])
    j = np.zeros(count)
    for i in range(len(grey)):
        for turn in range(steps + 1):
            columns = _columns(place, offset[i], blur[i], curved[i], shift[i], table, root_table, A, slope)
            _normal_matrix(A, columns, N)
            _factor(N, columns, L)
            for k in range(columns):
                h[k] = 0.0
                for n in range(count):
                    h[k] += A[n, k] * grey[i, n]
            _solve(L, columns, h)
            jj, jr, rr = 0.0, 0.0, 0.0
            c[:] = 0.0
            for n in range(count):
                fit = h[0]
                j[n] = 0.0
                for k in range(1, columns):
                    fit += h[k] * A[n, k]
                    j[n] += h[k] * slope[n, k - 1]
                r = grey[i, n] - fit
                jj += j[n] * j[n]
                jr += j[n] * r
                rr += r * r
                for k in range(columns):
                    c[k] += A[n, k] * j[n]
            d = c.copy()
            _solve(L, columns, d)
            for k in range(columns):
                jj -= c[k] * d[k]
            information[i, 0], information[i, 1] = max(jj, 0.0), rr / max(count - columns - 1, 1)
            if turn == steps or jj <= 1e-9 or abs(jr / jj) < _SETTLED_PX:
                break
            shift[i] += min(max(jr / jj, -_LONGEST_PX), _LONGEST_PX)
        lines = columns - 2 if curved[i] else columns - 1
        for k in range(height.shape[1]):
            height[i, k] = h[1 + k] if k < lines else 0.0


@compiled_ieee
def _scan(
    place: Array,
    grey: Array,
    offset: Array,
    blur: Array,
    shifts: int,
    table: Array,
    best: Array,
    left: Array,
) -> None:
    """The shift of least squares, among ``shifts`` samples to either side.

    Displaced by whole samples, all models of a profile are windows of one: sums over a window are differences
    of running sums.
    """
    count, lines = len(place), offset.shape[1]
    longer = count + 2 * shifts
    A = np.ones((longer, 1 + lines))
    running = np.zeros((1 + lines, 1 + lines, longer + 1))
    N, L = np.zeros((1 + lines, 1 + lines)), np.zeros((1 + lines, 1 + lines))
    h, b = np.zeros(1 + lines), np.zeros(1 + lines)
    for i in range(len(grey)):
        columns = 1
        for k in range(lines):
            if offset[i, k] != offset[i, k]:
                break
            columns += 1
            for n in range(longer):
                z = (place[0] + (n - shifts) * STEP_PX - offset[i, k]) / blur[i, k]
                A[n, 1 + k] = _blurred_step(z, table)
        for p in range(columns):
            for q in range(p + 1):
                for n in range(longer):
                    running[p, q, n + 1] = running[p, q, n] + A[n, p] * A[n, q]
        energy = 0.0
        for n in range(count):
            energy += grey[i, n] * grey[i, n]
        left[i] = np.inf
        for s in range(2 * shifts + 1):
            # displaced by s - shifts samples, place n of the profile is place n - s + 2 shifts of the model
            first = 2 * shifts - s
            for p in range(columns):
                for q in range(p + 1):
                    N[p, q] = running[p, q, first + count] - running[p, q, first]
                N[p, p] += _RIDGE
                b[p] = 0.0
                for n in range(count):
                    b[p] += A[first + n, p] * grey[i, n]
                h[p] = b[p]
            _factor(N, columns, L)
            _solve(L, columns, h)
            total = energy
            for p in range(columns):
                total -= h[p] * b[p] + _RIDGE * h[p] * h[p]
            if total < left[i]:
                left[i], best[i] = total, (s - shifts) * STEP_PX
