"""The solvers by name (docs/compare.md), their protocol, and the record of their progress.

Each runs in a process of its own, and its adapter is imported there only.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from time import perf_counter
from typing import Literal, Protocol

import numpy as np

from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.rows import Kept
from polhode.config.keys import suggestion
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError

Claim = Literal["ok", "baseline"]
"""Convergence on the common cost, or a result of another formulation."""


class OutOfTime(Exception):
    """The solver has reached its time limit; the points that it recorded are kept."""


@dataclass(frozen=True)
class AdapterResult:
    """Where a solver stopped, in the common unknowns."""

    x: Array
    """(n,) about the fixed reference"""
    converged: bool
    """What the solver itself claims"""
    iterations: int
    message: str
    cov_constants: Array | None = None
    """(8, 8) of com_G, xi by the solver's own linear algebra; None: it computes none"""


@dataclass
class SolveMonitor:
    """Clock of a solve, and the cost at each iteration."""

    limit_s: float
    start: float = field(default_factory=perf_counter)
    trace: list[tuple[float, float]] = field(default_factory=list)
    """(seconds since the start, cost) at each iteration"""
    best: tuple[float, Array] | None = None
    """Least common cost that was recorded, and its point"""
    last: Array | None = None
    """Last point of a method whose own cost during the iterations is not the common one"""
    end: float | None = None
    """When the solution was reached"""

    def elapsed(self) -> float:
        """Seconds from the start to now, or to ``stop``."""
        return (self.end or perf_counter()) - self.start

    def stop(self) -> bool:
        """End the measured time: covariances do not count. Whether there is time left for them."""
        self.end = perf_counter()
        return self.left() > 0.25 * self.elapsed()

    def left(self) -> float:
        """Seconds until the limit."""
        return self.limit_s - self.elapsed()

    def check(self) -> None:
        """Raises OutOfTime when the limit is passed."""
        if self.left() <= 0.0:
            raise OutOfTime

    def record(self, cost: float, x: Array | None = None, common: bool = True) -> None:
        """Record an iteration that ended at this cost, with the common unknowns x (n,).

        ``common``: it is the common cost. If not, the last point is kept instead of the best.
        """
        self.trace.append((self.elapsed(), float(cost)))
        if x is None or (common and not cost < (np.inf if self.best is None else self.best[0])):
            return
        if common:
            self.best = (float(cost), x.copy())
        else:
            self.last = x.copy()

    def kept(self) -> tuple[Kept, Array | None]:
        """The point that is kept of a solver that did not finish."""
        if self.best is not None:
            return "best", self.best[1]
        return ("nothing", None) if self.last is None else ("last", self.last)


class Solver(Protocol):
    """One method; a new object for each solve."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Minimise from x (n,). Raises OutOfTime at the limit; any other error is a failed row."""
        ...


@dataclass(frozen=True)
class Entry:
    """An adapter, described without importing it."""

    name: str
    family: str
    adapter: str
    """MODULE:NAME of a class that is called with the options; the module is in ``solvers`` or has a dot"""
    options: dict[str, str] = field(default_factory=dict)
    claim: Claim = "ok"
    needs: str = ""
    """A package beyond those that polhode always has"""

    def missing(self) -> str | None:
        """The package that it needs, if it is not installed."""
        return self.needs if self.needs and find_spec(self.needs) is None else None

    def load(self) -> Solver:
        """Import the adapter."""
        module, _, name = self.adapter.partition(":")
        home = import_module(module if "." in module else f"polhode.compare.solvers.{module}")
        make: Callable[..., Solver] = getattr(home, name)
        return make(**self.options)


ENTRIES: tuple[Entry, ...] = (
    Entry("gauss_newton", "ours", "ours:Ours"),
    Entry("gauss_newton_ratios", "ours", "ours:Ours", {"form": "ratios_axes"}),
    Entry("ipopt", "ipopt", "ipopt:Ipopt"),
    Entry("ceres", "ceres", "ceres:Ceres", needs="pyceres"),
    Entry("gtsam_lm", "gtsam", "gtsam_lm:LevenbergMarquardt", needs="gtsam"),
    Entry("odometry", "baselines", "ours:Odometry", claim="baseline"),
)


def entries(names: tuple[str, ...] = ()) -> tuple[Entry, ...]:
    """The entries named, in that order; without names, all. Raises InputError."""
    known = {entry.name: entry for entry in ENTRIES}
    for name in names:
        if name not in known:
            hint = suggestion(name, list(known))
            raise InputError(f"compare.solvers: unknown solver '{name}';{hint} solvers: {', '.join(known)}")
    return tuple(known[name] for name in names) or ENTRIES
