"""The smallest set of edges that keeps the sigma of each degree of freedom within 10 % of that of all edges.

Sigma is the root of the mean variance over the views in which all edges determine the degree of freedom. A
forward greedy adds the edge that most lowers the excesses over the limits, in logarithms, until none is left;
then redundant edges are removed. A second set results from all edges by backward elimination. In the smaller
one, two edges are exchanged for one while that is possible. Several sets of the same size may exist. Among
more than 600 candidates, edges are added and removed a few at a time, and the set from all edges is left out.

The mean variances are convex in fractions w of the edges, so the least sum of fractions within the limits
bounds the number from below. Tangents of a convex function lie below it, so a linear program with some of
them as limits has an optimum that is no larger (cutting planes: Kelley, J. SIAM 8, 1960).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linprog

from polhode.geometry.lie import Array, Bools, Ints
from polhode.planning.edges.information import FeatureInformation, variances
from polhode.runtime.errors import InputError

FACTOR = 1.1
"""Largest admissible increase of sigma."""
MAX_EXCHANGES = 400_000
"""Pairs and the features that replace them, beyond which no exchange is tried"""
MANY_CANDIDATES = 600
"""Among more candidates, sets are built from several edges at a time."""
STEPS, CUTS = 200, 20
"""Number of such steps from none to all, and of tangents of each limit"""


@dataclass(frozen=True)
class SmallestSet:
    """A set of edges within the limits."""

    features: Ints
    """(k,) ascending"""
    ratio: Array
    """(6,) sigma over that with all features; NaN where no view determines it"""
    at_least: int
    """lower bound of the number of features"""


class SigmaLimits:
    """Limits of the sigmas that a set of edges must meet."""

    def __init__(self, information: FeatureInformation, factor: float = FACTOR) -> None:
        """Raises InputError where the edges determine nothing, or for a factor of 1 or less."""
        if factor <= 1.0:
            raise InputError(f"factor {factor:g} of the sigma with all edges: give a number above 1")
        self.C = information.scaled
        self.factor = factor
        self.full = variances(self.C.sum(axis=1), 1.0)
        self.observable = np.isfinite(self.full)
        if not self.observable.any():
            raise InputError("the edges determine no degree of freedom in any view: no set can be selected")
        self.degrees = np.flatnonzero(self.observable.any(axis=0))
        self.sum = np.where(self.observable, self.full, 0.0).sum(axis=0)
        self.candidates = np.flatnonzero((self.C.trace(axis1=2, axis2=3) > 0.0).any(axis=0))

    def ratio(self, total: Array) -> Array:
        """(..., 6) sigmas over those with all edges, of sums (..., T, 6, 6); NaN if never determined."""
        variance = np.where(self.observable, variances(total, 1.0), 0.0).sum(axis=-2)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt(variance / self.sum))

    def meets(self, total: Array) -> Bools:
        """(...) whether all limits are met."""
        return np.asarray((self.ratio(total)[..., self.degrees] <= self.factor).all(axis=-1))

    def excess(self, total: Array) -> Array:
        """(...) sum of the logarithmic excesses over the limits; finite, as a prior is added."""
        inverse = np.linalg.inv(total + np.eye(6))
        variance = np.where(self.observable, np.diagonal(inverse, axis1=-2, axis2=-1), 0.0).sum(axis=-2)
        over = 0.5 * np.log(variance[..., self.degrees] / self.sum[self.degrees]) - np.log(self.factor)
        # the small second term still gives a direction where the prior conceals the last excess
        return np.asarray(np.maximum(over, 0.0).sum(axis=-1) + 1e-3 * over.sum(axis=-1))

    def of(self, features: Ints | list[int]) -> Array:
        """(T, 6, 6) sum over the features."""
        return np.asarray(self.C[:, np.asarray(features, dtype=np.int64)].sum(axis=1))


def smallest_set(information: FeatureInformation, factor: float = FACTOR) -> SmallestSet:
    """A small set within the factor, and a lower bound of its size."""
    limits = SigmaLimits(information, factor)
    many = len(limits.candidates) > MANY_CANDIDATES
    together = len(limits.candidates) // STEPS if many else 1
    best = _without_redundant(limits, _forward_greedy(limits, together), together)
    if not many:
        best = min(_without_redundant(limits, limits.candidates.tolist(), 1), best, key=len)
    features = np.array(sorted(_exchange_pairs(limits, best)), dtype=np.int64)
    return SmallestSet(features, limits.ratio(limits.of(features)), min_number(limits))


def min_number(limits: SigmaLimits) -> int:
    """Lower bound of the number of features: the least sum of fractions, from below, rounded up."""
    C, total = limits.C[:, limits.candidates], limits.sum[limits.degrees]
    n = C.shape[1]
    # with equal fractions every variance rises by their inverse
    w = np.full(n, limits.factor**-2)
    rows, right, bound = [], [], 0.0
    for _ in range(CUTS):
        # excess (d,) of the relative variances over the limits, and its derivative (d, n)
        inverse = np.linalg.inv(np.einsum("n,tnij->tij", w, C) + 1e-9 * np.eye(6))
        own = np.where(limits.observable, np.diagonal(inverse, axis1=1, axis2=2), 0.0).sum(axis=0)
        each = np.einsum("tdi,tnij,tjd->tnd", inverse, C, inverse, optimize=True)
        part = np.where(limits.observable[:, None], each, 0.0).sum(axis=0)
        excess = own[limits.degrees] / total - limits.factor**2
        rows.append(-(part[:, limits.degrees] / total).T)
        right.append(rows[-1] @ w - excess)
        found = linprog(np.ones(n), np.vstack(rows), np.concatenate(right), bounds=(0.0, 1.0), method="highs")
        if found.x is None:
            break
        bound = max(bound, float(found.fun))
        # halfway: the optima of the first programs are far from the solution
        w = 0.5 * (np.clip(found.x, 0.0, 1.0) + w)
    return max(1, int(np.ceil(bound - 1e-6)))


def _forward_greedy(limits: SigmaLimits, together: int) -> list[int]:
    """From the empty set until all limits are met, ``together`` features at a time."""
    chosen: list[int] = []
    total = np.zeros_like(limits.C[:, 0])
    free = limits.candidates
    while not bool(limits.meets(total)) and len(free):
        excess = limits.excess(total + np.swapaxes(limits.C[:, free], 0, 1))
        best = np.argsort(excess, kind="stable")[:together]
        chosen += free[best].tolist()
        total = total + limits.of(free[best])
        free = np.delete(free, best)
    return chosen


def _without_redundant(limits: SigmaLimits, chosen: list[int], together: int) -> list[int]:
    """Backward elimination: the least important features are removed while the limits are met."""
    total = limits.of(chosen)
    while len(chosen) > 1:
        left = total - np.swapaxes(limits.C[:, chosen], 0, 1)
        ratio = np.nan_to_num(limits.ratio(left)[:, limits.degrees], nan=np.inf).max(axis=1)
        weakest = np.argsort(ratio, kind="stable")[: min(together, len(chosen) - 1)]
        # as many of the weakest as the limits allow, halving
        while len(weakest) > 1 and not limits.meets(total - limits.of([chosen[at] for at in weakest])):
            weakest = weakest[: len(weakest) // 2]
        if ratio[weakest[0]] > limits.factor:
            break
        total = total - limits.of([chosen[at] for at in weakest])
        chosen = np.delete(chosen, weakest).tolist()
        if together > 1 or len(chosen) % 16 == 0:
            total = limits.of(chosen)
    return chosen


def _exchange_pairs(limits: SigmaLimits, chosen: list[int]) -> list[int]:
    """Exchange two features for one while possible and the pairs are not too many to test."""
    while True:
        free = np.setdiff1d(limits.candidates, chosen)
        pairs = np.array(list(combinations(range(len(chosen)), 2)))
        if len(free) == 0 or len(pairs) == 0 or len(pairs) * len(free) > MAX_EXCHANGES:
            return chosen
        total = limits.of(chosen)
        members = np.swapaxes(limits.C[:, chosen], 0, 1)
        less = total - members[pairs[:, 0]] - members[pairs[:, 1]]
        for i in free.tolist():
            good = np.flatnonzero(limits.meets(less + limits.C[:, i]))
            if len(good):
                a, b = pairs[good[0]]
                chosen = [f for k, f in enumerate(chosen) if k not in (a, b)] + [i]
                break
        else:
            return chosen
