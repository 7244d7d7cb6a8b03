"""Least squares of the disparity over square windows, compiled; each point stops when it has converged.

Model: left(u + x, v + y) = gain * right(u + x - d - a x - b y, v + y) + offset, for (x, y) in a window around
a whole pixel, so that the left image is not interpolated, and the right one only along its rows. Gain and
offset are estimated directly, the warp (d, a, b) by increments.
"""

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Ints
from polhode.geometry.small_systems import solve_symmetric
from polhode.runtime.compiled import compiled_reordered

WINDOW_PX = 13
"""Side of the window, odd."""
CONVERGED_PX = 1e-3
"""A smaller step of the disparity ends the iteration [px]."""
MAX_STEP_PX, MAX_STEP_SLOPE = 1.0, 0.2
"""Largest step of d, and of a and b."""
MAX_SLOPE = 0.8
"""Largest a and b."""
MIN_GAIN, MAX_GAIN = 0.3, 3.0
"""Range of the exposure ratio by which slopes are scaled."""
REGULARISATION = (1e-2, 1e-1, 1e-1, 1e-6, 1e-6)
"""A textureless window leaves the warp undetermined: with this it keeps its initial value."""
_HALF = WINDOW_PX // 2
_N = 5
"""Unknowns: d, a, b, gain, offset"""
_PIXELS = WINDOW_PX**2


def _window() -> tuple[Array, Array, Array]:
    """Columns, rows and weights (169,) of the window's pixels."""
    y, x = (axis.ravel().astype(np.float64) for axis in np.mgrid[-_HALF : _HALF + 1, -_HALF : _HALF + 1])
    return x, y, np.exp(-(x**2 + y**2) / (2.0 * (0.6 * _HALF) ** 2))


_X, _Y, _WEIGHT = _window()
_WEIGHT_SUM = float(_WEIGHT.sum())


@compiled_reordered
def fit_windows(
    left: NDArray[np.uint8], spline: Array, centre: Ints, arm: Array, warp: Array, iterations: int
) -> tuple[Array, Array, Array]:
    """Improve the warps (n, 3) in place, and judge the fits at the points, ``arm`` (n, 2) from the centres.

    left (H, W); spline (H, W): B-spline coefficients of the right image's rows; centre (n, 2): whole pixels.
    Returns (n,) the standard deviation of a disparity for noise of one grey level, the root mean square of
    the residuals, and the normalised correlation of the windows.
    """
    n = len(centre)
    spread, scatter, correlation = np.empty(n), np.empty(n), np.empty(n)
    s, e, t = np.empty(_PIXELS), np.empty(_PIXELS), np.empty(_PIXELS)
    A, b = np.empty((_N, _N)), np.empty(_N)
    L, step = np.zeros((_N, _N)), np.empty(_N)
    for k in range(n):
        _read(left, centre[k, 0], centre[k, 1], t)
        for _ in range(iterations):
            _sample(spline, centre[k, 0], centre[k, 1], warp[k], s, e)
            _equations(s, e, t, A, b)
            solve_symmetric(A, b, L, step)
            warp[k, 0] += min(max(step[0], -MAX_STEP_PX), MAX_STEP_PX)
            for a in range(1, 3):
                slope = warp[k, a] + min(max(step[a], -MAX_STEP_SLOPE), MAX_STEP_SLOPE)
                warp[k, a] = min(max(slope, -MAX_SLOPE), MAX_SLOPE)
            if abs(step[0]) < CONVERGED_PX:
                break
        _sample(spline, centre[k, 0], centre[k, 1], warp[k], s, e)
        gain = _equations(s, e, t, A, b)
        solve_symmetric(A, b, L, step)
        square, in_s, in_t, both = 0.0, 0.0, 0.0, 0.0
        mean_s, mean_t = A[3, 4] / _WEIGHT_SUM, b[4] / _WEIGHT_SUM
        for i in range(_PIXELS):
            slope = step[0] + step[1] * _X[i] + step[2] * _Y[i]
            residual = t[i] + gain * e[i] * slope - step[3] * s[i] - step[4]
            square += _WEIGHT[i] * residual * residual
            away_s, away_t = s[i] - mean_s, t[i] - mean_t
            in_s += _WEIGHT[i] * away_s * away_s
            in_t += _WEIGHT[i] * away_t * away_t
            both += _WEIGHT[i] * away_s * away_t
        scatter[k] = np.sqrt(square / (_WEIGHT_SUM - _N))
        correlation[k] = both / max(np.sqrt(in_s * in_t), 1e-9 * _WEIGHT_SUM)
        b[0], b[1], b[2], b[3], b[4] = 1.0, arm[k, 0], arm[k, 1], 0.0, 0.0
        solve_symmetric(A, b, L, step)
        spread[k] = np.sqrt(max(step[0] + arm[k, 0] * step[1] + arm[k, 1] * step[2], 0.0))
    return spread, scatter, correlation


@compiled_reordered
def _read(left: NDArray[np.uint8], u: int, v: int, t: Array) -> None:
    """The window of an image; beyond the image its border is repeated."""
    height, width = left.shape
    for y in range(WINDOW_PX):
        row = min(max(v + y - _HALF, 0), height - 1)
        for x in range(WINDOW_PX):
            t[y * WINDOW_PX + x] = left[row, min(max(u + x - _HALF, 0), width - 1)]


@compiled_reordered
def _sample(spline: Array, u: int, v: int, warp: Array, s: Array, e: Array) -> None:
    """Values and slopes along the row of a cubic B-spline at the warped window."""
    height, width = spline.shape
    last = width - 3.001
    for y in range(WINDOW_PX):
        row = spline[min(max(v + y - _HALF, 0), height - 1)]
        start = u - warp[0] - warp[2] * (y - _HALF)
        for x in range(WINDOW_PX):
            at = min(max(start + (x - _HALF) * (1.0 - warp[1]), 1.0), last)
            first = int(at)
            f = at - first
            g = 1.0 - f
            p0, p1, p2, p3 = row[first - 1], row[first], row[first + 1], row[first + 2]
            inner = p1 * (4.0 - f * f * (6.0 - 3.0 * f)) + p2 * (1.0 + 3.0 * f * (1.0 + f * g))
            s[y * WINDOW_PX + x] = (p0 * g * g * g + inner + p3 * f * f * f) / 6.0
            middle = p1 * f * (3.0 * f - 4.0) + p2 * (1.0 + f * (2.0 - 3.0 * f))
            e[y * WINDOW_PX + x] = 0.5 * (middle + p3 * f * f - p0 * g * g)


@compiled_reordered
def _equations(s: Array, e: Array, t: Array, A: Array, b: Array) -> float:
    """Normal matrix (5, 5) and right-hand side (5,) from the right window s, its slopes e and the left one t.

    Returns the exposure ratio by which the slopes are scaled.
    """
    sum_s, sum_t, sum_ss, sum_st = 0.0, 0.0, 0.0, 0.0
    ee, eex, eey, eexx, eexy, eeyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    es, esx, esy, e1, ex, ey, et, etx, ety = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ss, s1, st, t1 = 0.0, 0.0, 0.0, 0.0
    for i in range(_PIXELS):
        x, y, w, si, ei, ti = _X[i], _Y[i], _WEIGHT[i], s[i], e[i], t[i]
        sum_s += si
        sum_t += ti
        sum_ss += si * si
        sum_st += si * ti
        we, ws = w * ei, w * si
        wee, wes, wet = we * ei, we * si, we * ti
        ee += wee
        eex += wee * x
        eey += wee * y
        eexx += wee * x * x
        eexy += wee * x * y
        eeyy += wee * y * y
        es += wes
        esx += wes * x
        esy += wes * y
        e1 += we
        ex += we * x
        ey += we * y
        et += wet
        etx += wet * x
        ety += wet * y
        ss += ws * si
        s1 += ws
        st += ws * ti
        t1 += w * ti
    in_s = sum_ss - sum_s * sum_s / _PIXELS
    in_both = sum_st - sum_s * sum_t / _PIXELS
    gain = min(max(in_both / max(in_s, 1e-6), MIN_GAIN), MAX_GAIN)
    square = gain * gain
    A[0, 0], A[1, 0], A[2, 0] = square * ee, square * eex, square * eey
    A[1, 1], A[2, 1], A[2, 2] = square * eexx, square * eexy, square * eeyy
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = -gain * es, -gain * esx, -gain * esy, ss
    A[4, 0], A[4, 1], A[4, 2], A[4, 3], A[4, 4] = -gain * e1, -gain * ex, -gain * ey, s1, _WEIGHT_SUM
    for i in range(_N):
        A[i, i] += REGULARISATION[i]
        for j in range(i):
            A[j, i] = A[i, j]
    b[0], b[1], b[2], b[3], b[4] = -gain * et, -gain * etx, -gain * ety, st, t1
    return gain
