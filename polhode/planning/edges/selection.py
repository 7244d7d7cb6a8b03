"""The best set of so many edges: greedy, and an upper bound of what any set of that size can reach.

For features with information C_ti in view t (translations in radii, rotations in radians, one pixel of
noise), a set S has M_t(S) = I + sum of C_ti. The identity is a prior of one radius and one radian: it gives
the empty set a finite value, and it is negligible against the information of the edges. The value of a set is
6 - tr M_t^-1, the fall of the summed variances (A-optimality), in the mean over the views.

The value is not submodular: two edges together may determine what neither determines alone, so that greedy
selection has no constant guarantee. It is concave in fractions w of the edges, 0 <= w <= 1. The tangent plane
of a concave function at any w lies above it; its maximum within the budget is a fractional knapsack. So each
w gives a bound on the best selection, and the steps of Frank and Wolfe (Naval Research Logistics 3, 1956)
tighten it.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, Ints

STEPS, HALVINGS = 60, 8
"""Of Frank and Wolfe, and of the interval in which the length of a step is sought"""
CLOSE = 1e-9
"""Gap between value and bound at which the steps end"""


@dataclass(frozen=True)
class EdgeSelection:
    """A set of features."""

    features: Ints
    """(k,) in the order in which they were chosen"""
    value: float


def value_of(M: Array) -> Array:
    """Values (...,) of M (..., T, 6, 6) = I + C, means over the views."""
    return np.asarray(6.0 - np.trace(np.linalg.inv(M), axis1=-2, axis2=-1).mean(axis=-1))


def greedy(scaled: Array, count: int) -> EdgeSelection:
    """At most ``count`` features of scaled information (T, n, 6, 6), the largest gain first.

    Fewer where the others have no information. Ties go to the lower index.
    """
    free = np.flatnonzero((scaled.trace(axis1=2, axis2=3) > 0.0).any(axis=0))
    M, value, chosen = np.tile(np.eye(6), (len(scaled), 1, 1)), 0.0, list[int]()
    while len(chosen) < count and len(free):
        best = int(np.argmax(value_of(M + np.swapaxes(scaled[:, free], 0, 1)) - value))
        chosen.append(int(free[best]))
        free = np.delete(free, best)
        M = M + scaled[:, chosen[-1]]
        value = float(value_of(M))
    return EdgeSelection(np.array(chosen, dtype=np.int64), value)


def upper_bound(scaled: Array, count: int) -> float:
    """Upper bound of the value of any set of ``count`` features of (T, n, 6, 6)."""
    n = scaled.shape[1]
    w, bound = np.full(n, min(1.0, count / n)), np.inf
    for _ in range(STEPS):
        M = np.eye(6) + np.einsum("n,tnij->tij", w, scaled)
        inverse = np.linalg.inv(M)
        # derivative of the value with respect to the fractions
        slope = np.einsum("tij,tnji->n", inverse @ inverse, scaled, optimize=True) / len(M)
        corner = np.zeros(n)
        corner[np.argsort(-slope, kind="stable")] = np.clip(count - np.arange(n), 0.0, 1.0)
        gap = float(slope @ (corner - w))
        bound = min(bound, float(value_of(M)) + gap)
        if gap < CLOSE:
            break
        # the step length in [0, 1] that maximizes the value: bisection on the slope
        step = np.einsum("n,tnij->tij", corner - w, scaled)
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            s = 0.5 * (low + high)
            inverse = np.linalg.inv(M + s * step)
            uphill = float(np.einsum("tij,tji->", inverse @ inverse, step)) > 0.0
            low, high = (s, high) if uphill else (low, s)
        w = w + 0.5 * (low + high) * (corner - w)
    return bound
