"""Selection of edges under a budget: greedy, upper bounds on any selection, and the optimum for few edges.

For features with information C_ti in view t (translations in radii, rotations in radians, one pixel of
noise), a set S has M_t(S) = I + sum of C_ti. The identity is a prior of one radius and one radian: it gives
the empty set a finite value, and it is negligible against the information of the edges. Two values, both
means over the views, both 0 for the empty set and non-decreasing in the set:

log_det: log det M_t. Submodular: the gain of an edge falls as the set grows. Greedy is then at least 1 - 1/e
    = 63 % of the optimum under a cardinality budget (Nemhauser, Wolsey, Fisher, Math. Programming 14, 1978),
    and an edge's earlier gain bounds its later one, so most gains need not be recomputed (lazy evaluation:
    Minoux, 1978). Under a length budget the better of greedy by value and greedy by value per metre is at
    least half of that (Leskovec et al., KDD 2007).
trace: 6 - tr M_t^-1, the fall of the summed variances (A-optimality). Not submodular: two edges together may
    determine what neither determines alone. No such constant exists; the bound is computed afterwards for
    the case at hand (`upper_bound`), which is valid for both values and usually much tighter. What counts
    is how much of the 6 remains, so greedy is followed by exchanges of one edge for another.

Both values are concave in fractions w of the edges, 0 <= w <= 1. The tangent plane of a concave function at
any w lies above it; its maximum within the budget is a fractional knapsack. So each w gives a bound on the
best selection, and the steps of Frank and Wolfe (Naval Research Logistics 3, 1956) tighten it. With this
bound, branch and bound finds the best selection.
"""

import heapq
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from polhode.errors import InputError
from polhode.lie import Array
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.orientation import evenly_over_the_sphere
from polhode.planning.edges.visible_edges import outlines
from polhode.records import Bools, Ints

Value = Literal["log_det", "trace"]
OUTLINE_VIEWS = 30


@dataclass(frozen=True)
class EdgeSelection:
    """A set of features."""

    features: Ints
    """(k,) in the order in which they were chosen"""
    value: float
    cost: float
    evaluations: int
    """number of sets whose value was computed"""


def value_of(M: Array, value: Value) -> Array:
    """Values (...,) of M (..., T, 6, 6) = I + C, means over the views."""
    if value == "log_det":
        return np.asarray(np.linalg.slogdet(M)[1].mean(axis=-1))
    return np.asarray(6.0 - np.trace(np.linalg.inv(M), axis1=-2, axis2=-1).mean(axis=-1))


def value_of_set(scaled: Array, features: Ints, value: Value) -> float:
    """Value of features (k,) with scaled information (T, n, 6, 6)."""
    return float(value_of(np.eye(6) + scaled[:, features].sum(axis=1), value))


def greedy(scaled: Array, budget: float, value: Value, cost: Array | None = None) -> EdgeSelection:
    """A set of features of scaled information (T, n, 6, 6) whose cost is within the budget.

    ``cost`` (n,) is 1 for each feature unless given, as in `edge_lengths`. Ties go to the lower index.
    Raises InputError for a budget that is smaller than every cost.
    """
    price = _price(scaled, cost)
    check(price, budget)
    informative = (scaled.trace(axis1=2, axis2=3) > 0.0).any(axis=0)
    by_value = _greedy(scaled, budget, value, price, informative, np.ones(len(price)))
    if np.ptp(price) < 1e-12 * price.max():
        return by_value
    by_price = _greedy(scaled, budget, value, price, informative, price)
    best = by_price if by_price.value > by_value.value else by_value
    return replace(best, evaluations=by_value.evaluations + by_price.evaluations)


def _price(scaled: Array, cost: Array | None) -> Array:
    """(n,)"""
    return np.ones(scaled.shape[1]) if cost is None else np.asarray(cost, dtype=np.float64)


def check(price: Array, budget: float) -> None:
    """Raises InputError where no feature can be selected."""
    if not np.isfinite(price).all() or (price <= 0.0).any():
        raise InputError("costs of edges must be positive")
    if len(price) == 0 or price.min() > budget:
        raise InputError(f"a budget of {budget:g} is smaller than the cost of every edge")


def _greedy(
    scaled: Array, budget: float, value: Value, price: Array, informative: Bools, divisor: Array
) -> EdgeSelection:
    """Repeatedly add the feature with the largest gain over its divisor that fits the budget."""
    M = np.tile(np.eye(6), (len(scaled), 1, 1))
    chosen: list[int] = []
    now, left = 0.0, float(budget) + 1e-12 * abs(budget)
    candidates = np.flatnonzero(informative & (price <= left))
    gain = value_of(M + np.swapaxes(scaled[:, candidates], 0, 1), value)
    evaluations = len(candidates)
    # (minus the gain, feature, size of the set when it was computed)
    heap = [(-g / divisor[i], int(i), 0) for g, i in zip(gain, candidates, strict=True)]
    heapq.heapify(heap)
    while heap:
        if value == "trace":
            heap = [entry for entry in heap if price[entry[1]] <= left]
            of = np.array([i for _, i, _ in heap], dtype=np.int64)
            gain = value_of(M + np.swapaxes(scaled[:, of], 0, 1), value) - now
            evaluations += len(of) if chosen else 0
            heap = [(-g / divisor[i], int(i), len(chosen)) for g, i in zip(gain, of, strict=True)]
            heapq.heapify(heap)
            if not heap:
                break
        _, i, size = heapq.heappop(heap)
        if price[i] > left:
            continue
        if size < len(chosen):
            gain_i = float(value_of(M + scaled[:, i], value)) - now
            evaluations += 1
            heapq.heappush(heap, (-gain_i / divisor[i], i, len(chosen)))
            continue
        chosen.append(i)
        M = M + scaled[:, i]
        left -= float(price[i])
        now = float(value_of(M, value))
    features = np.array(chosen, dtype=np.int64)
    return EdgeSelection(features, now, float(price[features].sum()), evaluations)


def improved_by_exchange(
    scaled: Array, start: EdgeSelection, budget: float, value: Value, cost: Array | None = None
) -> EdgeSelection:
    """The selection after exchanges of one feature for another, best first, while they improve it.

    Fedorov, Theory of Optimal Experiments, 1972. The result is never worse than the start.
    """
    price = _price(scaled, cost)
    chosen, now, evaluations = list(start.features.tolist()), start.value, start.evaluations
    spent = float(price[chosen].sum())
    informative = (scaled.trace(axis1=2, axis2=3) > 0.0).any(axis=0)
    while True:
        M = np.eye(6) + scaled[:, chosen].sum(axis=1)
        free = np.setdiff1d(np.flatnonzero(informative), chosen)
        best = (now * (1.0 + 1e-12), -1, -1)
        for position, i in enumerate(chosen):
            fits = free[spent - price[i] + price[free] <= budget * (1.0 + 1e-12)]
            if len(fits) == 0:
                continue
            values = value_of(M - scaled[:, i] + np.swapaxes(scaled[:, fits], 0, 1), value)
            evaluations += len(fits)
            at = int(np.argmax(values))
            best = max(best, (float(values[at]), -position, int(fits[at])))
        if best[2] < 0:
            break
        now, position, joining = best[0], -best[1], best[2]
        spent += float(price[joining] - price[chosen[position]])
        chosen[position] = joining
    features = np.array(chosen, dtype=np.int64)
    value_now = value_of_set(scaled, features, value)
    return EdgeSelection(features, value_now, float(price[features].sum()), evaluations)


def edge_lengths(model: EdgeModel) -> Array:
    """(size,) [m]: lengths of segments; of smooth parts the mean length of their outlines over all views."""
    total = np.zeros(len(model.outlined))
    towards = evenly_over_the_sphere(OUTLINE_VIEWS)
    if model.outlined.any():
        for eye_G in model.centre_G + 20.0 * model.radius_m * towards:
            seen = outlines(model, eye_G)
            np.add.at(total, seen.part, np.linalg.norm(seen.ends_G[:, 1] - seen.ends_G[:, 0], axis=1))
    # a flat part has no outline: any positive length serves
    curved = np.maximum(total / OUTLINE_VIEWS, model.tolerance_m)
    return np.concatenate([model.lengths_m, curved])


STEPS = 60
BRANCH_STEPS = 12
MAX_BRANCHES = 20_000
CLOSE = 1e-9
HALVINGS = 8


@dataclass(frozen=True)
class _PartialSelection:
    """A node of the branch and bound: features included, excluded or open."""

    taken: Bools
    """(n,)"""
    open_: Bools
    """(n,) undecided"""


def upper_bound(
    scaled: Array, budget: float, value: Value, cost: Array | None = None, steps: int = STEPS
) -> float:
    """Upper bound of the value of any set of features (T, n, 6, 6) within the budget."""
    n, price = scaled.shape[1], _price(scaled, cost)
    check(price, budget)
    case = _PartialSelection(np.zeros(n, dtype=bool), np.ones(n, dtype=bool))
    return _bound(scaled, budget, value, price, case, steps)[0]


def best_selection(scaled: Array, budget: float, value: Value, cost: Array | None = None) -> EdgeSelection:
    """The set of the largest value within the budget, for tens of features.

    Raises InputError after too many branches, or when no feature fits the budget.
    """
    n, price = scaled.shape[1], _price(scaled, cost)
    best = improved_by_exchange(scaled, greedy(scaled, budget, value, price), budget, value, price)
    informative = (scaled.trace(axis1=2, axis2=3) > 0.0).any(axis=0)
    stack = [_PartialSelection(np.zeros(n, dtype=bool), informative)]
    branches = 0
    while stack:
        case = stack.pop()
        left = budget - price[case.taken].sum()
        case = _PartialSelection(case.taken, case.open_ & (price <= left + 1e-12 * budget))
        of_taken = float(value_of(np.eye(6) + scaled[:, case.taken].sum(axis=1), value))
        if of_taken > best.value:
            features = np.flatnonzero(case.taken)
            best = EdgeSelection(features, of_taken, float(price[features].sum()), branches)
        if not case.open_.any():
            continue
        branches += 1
        if branches > MAX_BRANCHES:
            raise InputError(
                f"no optimum of {n} edges within {MAX_BRANCHES} branches; use the greedy selection"
            )
        bound, shares = _bound(scaled, budget, value, price, case, BRANCH_STEPS, stop_below=best.value)
        if bound <= best.value + CLOSE:
            continue
        undecided = np.where(case.open_, np.abs(shares - 0.5), np.inf)
        i = int(np.argmin(undecided))
        without, with_it = case.open_.copy(), case.taken.copy()
        without[i], with_it[i] = False, True
        stack += [_PartialSelection(case.taken, without), _PartialSelection(with_it, without)]
    return EdgeSelection(best.features, best.value, best.cost, branches)


def _bound(
    scaled: Array,
    budget: float,
    value: Value,
    price: Array,
    case: _PartialSelection,
    steps: int,
    stop_below: float = -np.inf,
) -> tuple[float, Array]:
    """Upper bound of the value that a node can reach, and fractions (n,) that nearly attain it."""
    left = budget - float(price[case.taken].sum())
    w = np.where(case.taken, 1.0, 0.0)
    w = w + np.where(case.open_, min(1.0, left / max(float(price[case.open_].sum()), 1e-300)), 0.0)
    bound = np.inf
    for _ in range(steps):
        M = np.eye(6) + np.einsum("n,tnij->tij", w, scaled)
        slope = _slope(scaled, M, value)
        corner = _knapsack(slope, price, left, case)
        gap = float(slope @ (corner - w))
        bound = min(bound, float(value_of(M, value)) + gap)
        if bound <= stop_below + CLOSE or gap < CLOSE:
            break
        step = np.einsum("n,tnij->tij", corner - w, scaled)
        w = w + _step_length(M, step, value) * (corner - w)
    return bound, w


def _slope(scaled: Array, M: Array, value: Value) -> Array:
    """Derivative (n,) of the value with respect to the fractions."""
    inverse = np.linalg.inv(M)
    if value == "trace":
        inverse = inverse @ inverse
    return np.asarray(np.einsum("tij,tnji->n", inverse, scaled, optimize=True) / len(M))


def _knapsack(slope: Array, price: Array, left: float, case: _PartialSelection) -> Array:
    """Fractions (n,) of the largest sum of slopes: by slope per cost, the last one in part."""
    w = np.where(case.taken, 1.0, 0.0)
    members = np.flatnonzero(case.open_)
    order = members[np.argsort(-slope[members] / price[members], kind="stable")]
    before = np.cumsum(price[order]) - price[order]
    w[order] = np.clip((left - before) / price[order], 0.0, 1.0)
    return w


def _step_length(M: Array, step: Array, value: Value) -> float:
    """Step length in [0, 1] that maximizes the value along M + s step: bisection on the slope."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        s = 0.5 * (low + high)
        inverse = np.linalg.inv(M + s * step)
        if value == "trace":
            inverse = inverse @ inverse
        if float(np.einsum("tij,tji->", inverse, step)) > 0.0:
            low = s
        else:
            high = s
    return 0.5 * (low + high)
