"""What a solver is given and what it hands back: one adapter a module, all behind one protocol."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import Literal, Protocol

import numpy as np

from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver_progress import ProgressFiles
from polhode.lie import Array

Claim = Literal["ok", "baseline"]
"""Convergence on the common cost, or an answer by another formulation."""
Part = Literal["build", "evaluation"]
Kept = Literal["answer", "best", "last", "nothing"]
"""Whose cost a row tells: the solver's answer, the best or the last point of one that did not converge."""


class OutOfTime(Exception):
    """The time of a solver is up; what it noted is kept."""


@dataclass(frozen=True)
class Outcome:
    """Where a solver stopped, in the common unknowns."""

    x: Array
    """(n,) around the reference that is held"""
    converged: bool
    """What the solver itself claims"""
    iterations: int
    message: str
    cov_constants: Array | None = None
    """(8, 8) of com_G, xi by the solver's own linear algebra; None: it has none"""


@dataclass
class SolveMonitor:
    """Clock of a solve: its parts, and the cost at each iteration."""

    limit_s: float
    start: float = field(default_factory=perf_counter)
    seconds: dict[Part, float] = field(default_factory=lambda: {"build": 0.0, "evaluation": 0.0})
    trace: list[tuple[float, float]] = field(default_factory=list)
    """(seconds since the start, cost) at each iteration"""
    best: tuple[float, Array] | None = None
    """Least common cost that was noted, and where"""
    last: Array | None = None
    """Last point of a method whose own cost on the way is not the common one"""
    end: float | None = None
    """When the solution was reached"""
    callback_s: float = 0.0
    """Spent in functions written in Python that a foreign library calls"""
    reached: ProgressFiles | None = None
    """Files to which all this is also written as it comes: what is left of a process that dies"""
    not_separable: str = ""
    """Why evaluation and linear algebra cannot be told apart; empty: they can"""
    words: str = ""
    """How far a method is that has no whole point on its way"""

    @contextmanager
    def part(self, name: Part) -> Iterator[None]:
        """Seconds of the block count as that part."""
        begin = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += perf_counter() - begin

    @contextmanager
    def callback(self, part: Part | None = "evaluation") -> Iterator[None]:
        """Seconds that a foreign library spent in Python: an evaluation, or linear algebra of ours (None)."""
        begin = perf_counter()
        try:
            yield
        finally:
            spent = perf_counter() - begin
            if part is not None:
                self.seconds[part] += spent
            self.callback_s += spent

    def elapsed(self) -> float:
        """Seconds since the start; until it was stopped."""
        return (self.end or perf_counter()) - self.start

    def stop(self) -> bool:
        """The solution is reached: covariances do not count. Whether there is time for them."""
        self.end = perf_counter()
        return self.left() > 0.25 * self.elapsed()

    def left(self) -> float:
        """Seconds until the limit."""
        return self.limit_s - self.elapsed()

    def note(self, cost: float, x: Array | None = None, common: bool = True) -> None:
        """One iteration ended at this cost, with the common unknowns x (n,).

        ``common``: it is the common cost. If not, the last point is kept instead of the best.
        """
        self.trace.append((self.elapsed(), float(cost)))
        if self.reached is not None:
            self.reached.cost(*self.trace[-1])
        if x is None or (common and not cost < (np.inf if self.best is None else self.best[0])):
            return
        if common:
            self.best = (float(cost), x.copy())
        else:
            self.last = x.copy()
        if self.reached is not None:
            self.reached.point(x, "best" if common else "last")

    def kept(self) -> tuple[Kept, Array | None]:
        """What is left when there is no answer."""
        if self.best is not None:
            return "best", self.best[1]
        return ("nothing", None) if self.last is None else ("last", self.last)

    def tell(self, words: str) -> None:
        """How far it is, for a method that has no whole point on its way."""
        self.words = words
        if self.reached is not None:
            self.reached.words(words)

    def check(self) -> None:
        """Raises OutOfTime when the limit is passed."""
        if self.left() <= 0.0:
            raise OutOfTime


class Solver(Protocol):
    """One method; a new object for each solve. What is known of it without importing it: ``registry``."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """Minimise from x (n,). Raises OutOfTime at the limit; any other error is a failed row."""
        ...
