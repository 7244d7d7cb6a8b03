"""k1 and k2 of every mass distribution that the hull and the motion admit: a moment problem.

The hull is filled with N points of equal volume, with masses m_i from 0 to D / N of the whole: nowhere
negative, and nowhere denser than D times the mean over the hull. Without D the hull would bound nothing: any
distribution can shrink about its centre of mass, and the scale of the inertia is unknown. For a given centre
of mass, J and the conditions of the motion are linear in the masses. k1 and k2 are not; but the moment about
a given axis, over the largest or least about an axis across it, is a quotient of linear functions, and k1 or
k2 is at least its logarithm and equals it for a principal axis. Its largest value is a few linear programs
(Dinkelbach's method). Axes all around are tried, and replaced by the principal axes of what they lead to.
Equal moments are sought likewise, as linear equations in the plane of their axes. Every solution is a
possible body, so the extremes are hardly too wide; they are moved outwards by the resolution of the search.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from polhode.geometry.lie import Array
from polhode.pipeline.intervals.hull_and_limits import PAIRS, MotionLimits

MAX_STEPS = 8
MIN_GAIN = 2e-3
"""Of k1 or k2: a step that brings less is the last one."""
RESOLUTION = 0.02
"""Of the search and of the filling by points: by so much the ends are moved outwards. A third of the standard
deviation from which on a ratio counts as undetermined."""
AXES_ACROSS = np.stack([np.cos(np.pi / 8 * np.arange(8)), np.sin(np.pi / 8 * np.arange(8))])
"""Axes across another one, (2, 8): every 22.5 deg of half a turn."""
DIRECTIONS = np.array(
    [[x, y, z] for x in (0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)][5:], dtype=np.float64
).T
DIRECTIONS = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=0)
"""(3, 13) through the corners, edges and faces of a cube: nothing is farther than 28 deg from one."""


@dataclass(frozen=True)
class RatioIntervals:
    """Least and largest ratios, (2,) each: k1, k2."""

    low: Array
    high: Array


def ratio_intervals(
    points: Array, centers: Array, limits: MotionLimits, max_density_ratio: float
) -> RatioIntervals | None:
    """The intervals over centres of mass (n, 3); points (N, 3) fill the hull evenly. None: no body fits."""
    low, high = np.full(2, np.inf), np.zeros(2)
    for center in centers:
        bodies = _Bodies(points, center, limits.inertia_rows, max_density_ratio)
        for J in (first := bodies.first(limits.R_GP)):
            low, high = np.minimum(low, _ratios(J)), np.maximum(high, _ratios(J))
        if first:
            low = np.array([_least(bodies, low[k], limits.R_GP, k) for k in (0, 1)])
            high = np.array([_largest(bodies, high[k], limits.R_GP, k) for k in (0, 1)])
    if not np.isfinite(low).all():
        return None
    # k1 of a thin disc is ln 2, the largest of all bodies
    return RatioIntervals(
        np.maximum(low - RESOLUTION, 0.0), np.minimum(high + RESOLUTION, [np.log(2.0), np.inf])
    )


class _Bodies:
    """Possible inertias about a centre of mass, in the scale in which the mass is 1."""

    def __init__(self, points: Array, center: Array, rows: Array, max_density_ratio: float) -> None:
        arm = points - center
        square = np.sum(arm**2, axis=1)
        self.J = np.stack([(square if i == j else 0.0) - arm[:, i] * arm[:, j] for i, j in PAIRS])
        """(6, N) of each point with the whole mass"""
        self.axes = np.linalg.eigh(_matrix(self.J.mean(axis=1)))[1]
        """(3, 3) of the hull at uniform density"""
        # in units of the body's size, for the solver's tolerances
        self.unit = float(square.mean())
        self._equal = np.concatenate([np.ones((1, len(arm))), arm.T / np.sqrt(self.unit)])
        norm = np.linalg.norm(rows, axis=1, keepdims=True)
        self._below = rows / norm @ self.J / self.unit
        self._most = max_density_ratio / len(points)

    def extreme(self, direction: Array) -> Array | None:
        """The J (3, 3) that is largest along a direction (3, 3); None: there is none."""
        weights = _components(direction)
        cost = -(weights @ self.J) / self.unit / max(float(np.abs(weights).max()), 1e-300)
        return self._solve(cost, self._below)

    def most_different(self, axes: Array, which: int, ratio: float) -> Array | None:
        """A J (3, 3) whose ratio of moments exceeds ``ratio``, if one has its single axis along axes[:, 0].

        Single is the axis of the largest moment over the others (which 0, k1) or of the least (1, k2). The
        middle moment is the largest, or the least, about any axis across it, taken at some of these axes. One
        step of Dinkelbach's method for a quotient of linear functions. None: no body exceeds it.
        """
        sign = 1.0 if which == 0 else -1.0
        about = [_components(np.outer(axis, axis)) for axis in (axes[:, 1:] @ AXES_ACROSS).T]
        rows = sign * np.stack(about) @ self.J / self.unit
        below = np.concatenate(
            [np.pad(self._below, ((0, 0), (0, 1))), np.pad(rows, ((0, 0), (0, 1)), constant_values=-sign)]
        )
        single = _components(np.outer(axes[:, 0], axes[:, 0])) @ self.J / self.unit
        # k1: the single moment less ratio times the middle one; k2: the middle one less ratio times it
        cost = np.append(-single, ratio) if which == 0 else np.append(ratio * single, -1.0)
        return self._solve(cost, below, exceed=MIN_GAIN)

    def most_equal(self, axes: Array, sign: float) -> Array | None:
        """The J (3, 3) that is closest to isotropic in the plane of the first two axes (3, 3).

        The moment about the third is the largest (sign 1) or the smallest (-1). None: there is none.
        """
        a, b, c = (np.outer(axis, axis) for axis in axes.T)
        parts = [a - b]
        for i, j in ((0, 1), (0, 2), (1, 2)):
            mixed = np.outer(axes[:, i], axes[:, j])
            parts.append(mixed + mixed.T)
        parts.append(sign * (0.5 * (a + b) - c))
        rows = np.stack([_components(each) for each in parts]) @ self.J / self.unit
        # an additional unknown bounds the difference and the products of inertia
        bounded = np.concatenate([np.concatenate([rows[:-1], -rows[:-1]]), -np.ones((8, 1))], axis=1)
        below = np.pad(np.concatenate([self._below, rows[-1:]]), ((0, 0), (0, 1)))
        below = np.concatenate([below, bounded])
        return self._solve(np.append(np.zeros(self.J.shape[1]), 1.0), below)

    def _solve(self, cost: Array, below: Array, exceed: float = -np.inf) -> Array | None:
        """The J whose masses minimize a cost that falls below -exceed, below @ masses <= 0; None: none."""
        count = self.J.shape[1]
        more = len(cost) - count
        found = linprog(
            cost,
            A_ub=below,
            b_ub=np.zeros(len(below)),
            A_eq=np.pad(self._equal, ((0, 0), (0, more))),
            b_eq=np.array([1.0, 0.0, 0.0, 0.0]),
            bounds=[(0.0, self._most)] * count + [(0.0, None)] * more,
            method="highs",
        )
        if found.status != 0 or found.fun > -exceed:
            return None
        return _matrix(self.J @ found.x[:count])

    def first(self, R_GP: Array) -> list[Array]:
        """The bodies of the largest and the least moment about each estimated axis; empty: there is none."""
        found = []
        for axis in R_GP.T:
            for sign in (1.0, -1.0):
                body = self.extreme(sign * np.outer(axis, axis))
                if body is None:
                    return []
                found.append(body)
        return found


def _least(bodies: _Bodies, best: float, R_GP: Array, which: int) -> float:
    """The least value of k1 (which 0) or k2 (1), if below ``best``; 0 where two moments can be equal."""
    for axes in (R_GP, bodies.axes):
        for third in range(3):
            found = axes[:, [third - 2, third - 1, third]]
            last = np.inf
            for _ in range(MAX_STEPS):
                if best < RESOLUTION:
                    return 0.0
                J = bodies.most_equal(found, -1.0 if which == 0 else 1.0)
                if J is None or _ratios(J)[which] > last - MIN_GAIN:
                    break
                last = float(_ratios(J)[which])
                best = min(best, last)
                ascending = np.linalg.eigh(J)[1]
                found = ascending[:, [1, 2, 0]] if which == 0 else ascending
    return best


def _largest(bodies: _Bodies, best: float, R_GP: Array, which: int) -> float:
    """The largest value of k1 (which 0) or k2 (1), if it is above ``best``."""
    for single in (*(R_GP @ DIRECTIONS).T, *bodies.axes.T):
        axes = np.column_stack([single, *np.linalg.svd(single[None])[2][1:]])
        for _ in range(MAX_STEPS):
            J = bodies.most_different(axes, which, float(np.exp(best)))
            if J is None or _ratios(J)[which] < best + MIN_GAIN:
                break
            best = float(_ratios(J)[which])
            ascending = np.linalg.eigh(J)[1]
            axes = ascending[:, ::-1] if which == 0 else ascending
    return best


def _ratios(J: Array) -> Array:
    """k1, k2 (2,) of an inertia (3, 3)."""
    moments = np.log(np.maximum(np.linalg.eigvalsh(J), 1e-300))
    return np.array([moments[2] - moments[1], moments[1] - moments[0]])


def _components(direction: Array) -> Array:
    """Weights (6,) of J by PAIRS in the scalar product of a symmetric direction (3, 3) and J."""
    return np.array([direction[i, j] * (1.0 if i == j else 2.0) for i, j in PAIRS])


def _matrix(six: Array) -> Array:
    out = np.empty((3, 3))
    for value, (i, j) in zip(six, PAIRS, strict=True):
        out[i, j] = out[j, i] = value
    return out
