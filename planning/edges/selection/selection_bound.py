"""How good a choice of edges can be at all: an upper bound for any number of edges, and the best of few.

Both values of `selection.py` are concave in shares w of the edges, 0 <= w <= 1. The plane that touches a
concave function at any w lies above it; its highest point within the budget is a fractional knapsack. So each
w gives a bound on the best choice, and the steps of Frank and Wolfe (Naval Research Logistics 3, 1956) make
it closer. With it, branch and bound finds the best choice.
"""

from dataclasses import dataclass

import numpy as np

from polhode.errors import InputError
from polhode.lie import Array
from polhode.planning.edges.selection.selection import Chosen, Value, check, exchanged, greedy, value_of
from polhode.records import Bools

STEPS = 60
BRANCH_STEPS = 12
MOST_BRANCHES = 20_000
CLOSE = 1e-9
HALVINGS = 8


@dataclass(frozen=True)
class _Case:
    """A choice, some of it made."""

    taken: Bools
    """(n,)"""
    open_: Bools
    """(n,) not decided"""


def upper_bound(
    scaled: Array, budget: float, value: Value, cost: Array | None = None, steps: int = STEPS
) -> float:
    """No set of features of scaled information (T, n, 6, 6) within the budget has a larger value."""
    n = scaled.shape[1]
    price = np.ones(n) if cost is None else np.asarray(cost, dtype=np.float64)
    check(price, budget)
    case = _Case(np.zeros(n, dtype=bool), np.ones(n, dtype=bool))
    return _bound(scaled, budget, value, price, case, steps)[0]


def best_choice(scaled: Array, budget: float, value: Value, cost: Array | None = None) -> Chosen:
    """The set of the largest value within the budget. For tens of features.

    Raises InputError where it would take too long, or when no feature fits.
    """
    n = scaled.shape[1]
    price = np.ones(n) if cost is None else np.asarray(cost, dtype=np.float64)
    best = exchanged(scaled, greedy(scaled, budget, value, price), budget, value, price)
    tells = (scaled.trace(axis1=2, axis2=3) > 0.0).any(axis=0)
    stack = [_Case(np.zeros(n, dtype=bool), tells)]
    branches = 0
    while stack:
        case = stack.pop()
        left = budget - price[case.taken].sum()
        case = _Case(case.taken, case.open_ & (price <= left + 1e-12 * budget))
        of_taken = float(value_of(np.eye(6) + scaled[:, case.taken].sum(axis=1), value))
        if of_taken > best.value:
            features = np.flatnonzero(case.taken)
            best = Chosen(features, of_taken, float(price[features].sum()), branches)
        if not case.open_.any():
            continue
        branches += 1
        if branches > MOST_BRANCHES:
            raise InputError(
                f"the best of {n} edges was not found in {MOST_BRANCHES} branches; take the greedy choice"
            )
        bound, shares = _bound(scaled, budget, value, price, case, BRANCH_STEPS, stop_below=best.value)
        if bound <= best.value + CLOSE:
            continue
        undecided = np.where(case.open_, np.abs(shares - 0.5), np.inf)
        i = int(np.argmin(undecided))
        without, with_it = case.open_.copy(), case.taken.copy()
        without[i], with_it[i] = False, True
        stack += [_Case(case.taken, without), _Case(with_it, without)]
    return Chosen(best.features, best.value, best.cost, branches)


def _bound(
    scaled: Array,
    budget: float,
    value: Value,
    price: Array,
    case: _Case,
    steps: int,
    stop_below: float = -np.inf,
) -> tuple[float, Array]:
    """Upper bound of what can still become of a case, and shares (n,) that come near it."""
    left = budget - float(price[case.taken].sum())
    w = np.where(case.taken, 1.0, 0.0)
    w = w + np.where(case.open_, min(1.0, left / max(float(price[case.open_].sum()), 1e-300)), 0.0)
    lowest = np.inf
    for _ in range(steps):
        M = np.eye(6) + np.einsum("n,tnij->tij", w, scaled)
        slope = _slope(scaled, M, value)
        corner = _knapsack(slope, price, left, case)
        rest = float(slope @ (corner - w))
        lowest = min(lowest, float(value_of(M, value)) + rest)
        if lowest <= stop_below + CLOSE or rest < CLOSE:
            break
        step = np.einsum("n,tnij->tij", corner - w, scaled)
        w = w + _along(M, step, value) * (corner - w)
    return lowest, w


def _slope(scaled: Array, M: Array, value: Value) -> Array:
    """Derivative (n,) of the value by the shares."""
    inverse = np.linalg.inv(M)
    if value == "trace":
        inverse = inverse @ inverse
    return np.asarray(np.einsum("tij,tnji->n", inverse, scaled, optimize=True) / len(M))


def _knapsack(slope: Array, price: Array, left: float, case: _Case) -> Array:
    """Shares (n,) of the largest sum of slopes: the dearest first, the last one in part."""
    w = np.where(case.taken, 1.0, 0.0)
    members = np.flatnonzero(case.open_)
    order = members[np.argsort(-slope[members] / price[members], kind="stable")]
    before = np.cumsum(price[order]) - price[order]
    w[order] = np.clip((left - before) / price[order], 0.0, 1.0)
    return w


def _along(M: Array, step: Array, value: Value) -> float:
    """Where between 0 and 1 the value along M + s step is largest: halving by the sign of the slope."""
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
