"""The smallest set of edges that tells nearly as much as all: each degree of freedom's sigma within 10 %.

Sigma is the root of the mean variance over the views that tell the degree of freedom with all edges. Greedy
adds what lowers the excesses over the limit most, in logarithms, until none is left; then what is no longer
needed is taken out; a second set comes from all edges by taking out the least needed one each time. Of the
smaller one, two edges are exchanged for one while that can be done. Several sets of the same size may do.

The mean variances are convex in shares w of the edges, so the least sum of shares within the limits bounds
the number from below; its dual makes the bound hold although the program is solved only nearly.
"""

from dataclasses import dataclass
from itertools import combinations, islice
from math import comb

import numpy as np
from scipy.optimize import minimize, nnls

from polhode.errors import InputError
from polhode.lie import Array
from polhode.planning.edges.metric.information import FeatureInformation, variances
from polhode.records import Bools, Ints

FACTOR = 1.1
"""Of sigma."""
MAX_SETS = 2_000_000
AT_ONCE = 20_000
MAX_EXCHANGES = 400_000


@dataclass(frozen=True)
class SmallestSet:
    """Edges that do."""

    features: Ints
    """(k,) ascending"""
    ratio: Array
    """(6,) sigma over that with all features; NaN where no view tells it"""
    at_least: int
    """no smaller number of features does"""


class SigmaLimits:
    """What is asked of a set."""

    def __init__(self, information: FeatureInformation, factor: float = FACTOR) -> None:
        """Raises InputError where the edges tell nothing, or for a factor that leaves no room."""
        if factor <= 1.0:
            raise InputError(f"sigma may grow to {factor:g} of that with all edges: give more than 1")
        self.C = information.scaled
        self.factor = factor
        self.full = variances(self.C.sum(axis=1), 1.0)
        self.told = np.isfinite(self.full)
        if not self.told.any():
            raise InputError("the edges tell no degree of freedom in any view: there is nothing to keep")
        self.degrees = np.flatnonzero(self.told.any(axis=0))
        self.sum = np.where(self.told, self.full, 0.0).sum(axis=0)
        self.candidates = np.flatnonzero((self.C.trace(axis1=2, axis2=3) > 0.0).any(axis=0))

    def ratio(self, total: Array) -> Array:
        """(..., 6) sigmas over the full ones, of sums (..., T, 6, 6); NaN where no view tells it."""
        found = np.where(self.told, variances(total, 1.0), 0.0).sum(axis=-2)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt(found / self.sum))

    def meets(self, total: Array) -> Bools:
        """(...) whether all limits are kept."""
        return np.asarray((self.ratio(total)[..., self.degrees] <= self.factor).all(axis=-1))

    def excess(self, total: Array) -> Array:
        """(...) sum of the logarithms over the limits; finite: with a prior of one radius and radian."""
        inverse = np.linalg.inv(total + np.eye(6))
        found = np.where(self.told, np.diagonal(inverse, axis1=-2, axis2=-1), 0.0).sum(axis=-2)
        over = 0.5 * np.log(found[..., self.degrees] / self.sum[self.degrees]) - np.log(self.factor)
        # the small second part still leads on where the prior hides the last of the excess
        return np.asarray(np.maximum(over, 0.0).sum(axis=-1) + 1e-3 * over.sum(axis=-1))

    def of(self, features: Ints | list[int]) -> Array:
        """(T, 6, 6) sum of features."""
        return np.asarray(self.C[:, np.asarray(features, dtype=np.int64)].sum(axis=1))


def smallest_set(information: FeatureInformation, factor: float = FACTOR) -> SmallestSet:
    """A small set within the factor, and how small it could be."""
    need = SigmaLimits(information, factor)
    first = _thinned(need, _grown(need))
    second = _thinned(need, need.candidates.tolist())
    best = _exchanged(need, min((second, first), key=len))
    features = np.array(sorted(best), dtype=np.int64)
    return SmallestSet(features, need.ratio(need.of(features)), min_number(need))


def exact_smallest_set(information: FeatureInformation, factor: float = FACTOR) -> SmallestSet:
    """By trying all sets from the lower bound up. Raises InputError where these are too many."""
    need = SigmaLimits(information, factor)
    n, tried = len(need.candidates), 0
    for size in range(min_number(need), n + 1):
        tried += comb(n, size)
        if tried > MAX_SETS:
            raise InputError(f"{n} edges have more than {MAX_SETS} sets to try; take `smallest_set`")
        sets = combinations(need.candidates.tolist(), size)
        while some := list(islice(sets, AT_ONCE)):
            which = np.array(some)
            member = np.zeros((len(which), need.C.shape[1]))
            np.put_along_axis(member, which, 1.0, axis=1)
            total = np.einsum("sn,tnij->stij", member, need.C, optimize=True)
            good = np.flatnonzero(need.meets(total))
            if len(good):
                features = which[good[0]]
                return SmallestSet(features, need.ratio(need.of(features)), size)
    raise AssertionError("all features together are within any factor of themselves")


def min_number(need: SigmaLimits) -> int:
    """Lower bound of the number of features: the least sum of shares, by its dual, rounded up."""
    C, n = need.C[:, need.candidates], len(need.candidates)
    limit = need.factor**2

    def over(w: Array) -> Array:
        inverse = np.linalg.inv(np.einsum("n,tnij->tij", w, C) + 1e-9 * np.eye(6))
        found = np.where(need.told, np.diagonal(inverse, axis1=1, axis2=2), 0.0).sum(axis=0)
        return np.asarray(found[need.degrees] / need.sum[need.degrees] - limit)

    def slope(w: Array) -> Array:
        inverse = np.linalg.inv(np.einsum("n,tnij->tij", w, C) + 1e-9 * np.eye(6))
        each = np.einsum("tdi,tnij,tjd->tnd", inverse, C, inverse, optimize=True)
        part = np.where(need.told[:, None], each, 0.0).sum(axis=0)
        return np.asarray(-(part[:, need.degrees] / need.sum[need.degrees]).T)

    found = minimize(
        lambda w: float(w.sum()),
        np.ones(n),
        jac=lambda w: np.ones(n),
        bounds=[(1e-6, 1.0)] * n,
        constraints={"type": "ineq", "fun": lambda w: -over(w), "jac": lambda w: -slope(w)},
        method="SLSQP",
        options={"maxiter": 100, "ftol": 1e-6},
    )
    w = np.clip(found.x, 0.0, 1.0)
    value, gradient = over(w), slope(w)
    # multipliers for which the shares between 0 and 1 stand still; any are allowed, these are good
    inside = (w > 1e-3) & (w < 1.0 - 1e-3)
    multipliers = nnls(-gradient[:, inside].T, np.ones(int(inside.sum())))[0] if inside.any() else 0.0 * value
    of_shares = 1.0 + multipliers @ gradient
    touching = float(w.sum() + multipliers @ value)
    bound = touching + float(np.minimum(of_shares * (0.0 - w), of_shares * (1.0 - w)).sum())
    return max(1, int(np.ceil(bound - 1e-6)))


def _grown(need: SigmaLimits) -> list[int]:
    """From none, until all limits are kept."""
    chosen: list[int] = []
    total = np.zeros_like(need.C[:, 0])
    free = need.candidates.tolist()
    while not bool(need.meets(total)) and free:
        excess = need.excess(total + np.swapaxes(need.C[:, free], 0, 1))
        i = free.pop(int(np.argmin(excess)))
        chosen.append(i)
        total = total + need.C[:, i]
    return chosen


def _thinned(need: SigmaLimits, chosen: list[int]) -> list[int]:
    """Take out the least needed one while the limits are kept."""
    chosen = list(chosen)
    total = need.of(chosen)
    while len(chosen) > 1:
        left = total - np.swapaxes(need.C[:, chosen], 0, 1)
        ratio = np.nan_to_num(need.ratio(left)[:, need.degrees], nan=np.inf).max(axis=1)
        place = int(np.argmin(ratio))
        if ratio[place] > need.factor:
            break
        total = total - need.C[:, chosen.pop(place)]
        if len(chosen) % 16 == 0:
            total = need.of(chosen)
    return chosen


def _exchanged(need: SigmaLimits, chosen: list[int]) -> list[int]:
    """Two for one, while there is such an exchange and not too many to try."""
    while True:
        free = np.setdiff1d(need.candidates, chosen)
        pairs = np.array(list(combinations(range(len(chosen)), 2)))
        if len(free) == 0 or len(pairs) == 0 or len(pairs) * len(free) > MAX_EXCHANGES:
            return chosen
        total = need.of(chosen)
        members = np.swapaxes(need.C[:, chosen], 0, 1)
        less = total - members[pairs[:, 0]] - members[pairs[:, 1]]
        for i in free.tolist():
            good = np.flatnonzero(need.meets(less + need.C[:, i]))
            if len(good):
                a, b = pairs[good[0]]
                chosen = [f for k, f in enumerate(chosen) if k not in (a, b)] + [i]
                break
        else:
            return chosen
