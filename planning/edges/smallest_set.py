"""The smallest set of edges that keeps the sigma of each degree of freedom within 10 % of that of all edges.

Sigma is the root of the mean variance over the views in which all edges determine the degree of freedom. A
forward greedy adds the edge that most lowers the excesses over the limits, in logarithms, until none is left;
then redundant edges are removed. A second set results from all edges by backward elimination. In the smaller
one, two edges are exchanged for one while that is possible. Several sets of the same size may exist.

The mean variances are convex in fractions w of the edges, so the least sum of fractions within the limits
bounds the number from below; its dual makes the bound valid although the program is solved approximately.
"""

from dataclasses import dataclass
from itertools import combinations, islice
from math import comb

import numpy as np
from scipy.optimize import minimize, nnls

from polhode.errors import InputError
from polhode.lie import Array
from polhode.planning.edges.information import FeatureInformation, variances
from polhode.records import Bools, Ints

FACTOR = 1.1
"""Largest admissible increase of sigma."""
MAX_SETS = 2_000_000
AT_ONCE = 20_000
MAX_EXCHANGES = 400_000


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
    first = _backward_elimination(limits, _forward_greedy(limits))
    second = _backward_elimination(limits, limits.candidates.tolist())
    best = _exchange_pairs(limits, min((second, first), key=len))
    features = np.array(sorted(best), dtype=np.int64)
    return SmallestSet(features, limits.ratio(limits.of(features)), min_number(limits))


def exact_smallest_set(information: FeatureInformation, factor: float = FACTOR) -> SmallestSet:
    """Exhaustive search from the lower bound upwards. Raises InputError where the sets are too many."""
    limits = SigmaLimits(information, factor)
    n, tried = len(limits.candidates), 0
    for size in range(min_number(limits), n + 1):
        tried += comb(n, size)
        if tried > MAX_SETS:
            raise InputError(f"{n} edges have more than {MAX_SETS} sets to test; use `smallest_set`")
        sets = combinations(limits.candidates.tolist(), size)
        while some := list(islice(sets, AT_ONCE)):
            which = np.array(some)
            member = np.zeros((len(which), limits.C.shape[1]))
            np.put_along_axis(member, which, 1.0, axis=1)
            total = np.einsum("sn,tnij->stij", member, limits.C, optimize=True)
            good = np.flatnonzero(limits.meets(total))
            if len(good):
                features = which[good[0]]
                return SmallestSet(features, limits.ratio(limits.of(features)), size)
    raise AssertionError("the set of all features meets any limit")


def min_number(limits: SigmaLimits) -> int:
    """Lower bound of the number of features: the least sum of fractions, by its dual, rounded up."""
    C, n = limits.C[:, limits.candidates], len(limits.candidates)
    limit = limits.factor**2

    def excess(w: Array) -> Array:
        inverse = np.linalg.inv(np.einsum("n,tnij->tij", w, C) + 1e-9 * np.eye(6))
        variance = np.where(limits.observable, np.diagonal(inverse, axis1=1, axis2=2), 0.0).sum(axis=0)
        return np.asarray(variance[limits.degrees] / limits.sum[limits.degrees] - limit)

    def slope(w: Array) -> Array:
        inverse = np.linalg.inv(np.einsum("n,tnij->tij", w, C) + 1e-9 * np.eye(6))
        each = np.einsum("tdi,tnij,tjd->tnd", inverse, C, inverse, optimize=True)
        part = np.where(limits.observable[:, None], each, 0.0).sum(axis=0)
        return np.asarray(-(part[:, limits.degrees] / limits.sum[limits.degrees]).T)

    solution = minimize(
        lambda w: float(w.sum()),
        np.ones(n),
        jac=lambda w: np.ones(n),
        bounds=[(1e-6, 1.0)] * n,
        constraints={"type": "ineq", "fun": lambda w: -excess(w), "jac": lambda w: -slope(w)},
        method="SLSQP",
        options={"maxiter": 100, "ftol": 1e-6},
    )
    w = np.clip(solution.x, 0.0, 1.0)
    value, gradient = excess(w), slope(w)
    # multipliers for which fractions between 0 and 1 are stationary; any are valid, these give a tight bound
    inside = (w > 1e-3) & (w < 1.0 - 1e-3)
    multipliers = nnls(-gradient[:, inside].T, np.ones(int(inside.sum())))[0] if inside.any() else 0.0 * value
    reduced_cost = 1.0 + multipliers @ gradient
    lagrangian = float(w.sum() + multipliers @ value)
    bound = lagrangian + float(np.minimum(reduced_cost * (0.0 - w), reduced_cost * (1.0 - w)).sum())
    return max(1, int(np.ceil(bound - 1e-6)))


def _forward_greedy(limits: SigmaLimits) -> list[int]:
    """Forward greedy from the empty set until all limits are met."""
    chosen: list[int] = []
    total = np.zeros_like(limits.C[:, 0])
    free = limits.candidates.tolist()
    while not bool(limits.meets(total)) and free:
        excess = limits.excess(total + np.swapaxes(limits.C[:, free], 0, 1))
        i = free.pop(int(np.argmin(excess)))
        chosen.append(i)
        total = total + limits.C[:, i]
    return chosen


def _backward_elimination(limits: SigmaLimits, chosen: list[int]) -> list[int]:
    """Backward elimination: remove the least important feature while the limits are met."""
    chosen = list(chosen)
    total = limits.of(chosen)
    while len(chosen) > 1:
        left = total - np.swapaxes(limits.C[:, chosen], 0, 1)
        ratio = np.nan_to_num(limits.ratio(left)[:, limits.degrees], nan=np.inf).max(axis=1)
        weakest = int(np.argmin(ratio))
        if ratio[weakest] > limits.factor:
            break
        total = total - limits.C[:, chosen.pop(weakest)]
        if len(chosen) % 16 == 0:
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
