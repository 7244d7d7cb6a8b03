"""What a solver is given and what it hands back: one adapter a module, all behind one protocol."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Literal, Protocol

from pipeline.compare.measured_problem import MeasuredProblem
from polhode.lie import Array

Claim = Literal["ok", "baseline"]
"""Convergence on the common cost, or an answer by another formulation."""
Part = Literal["build", "evaluation"]


class OutOfTime(Exception):
    """The time of a solver is up; what it holds is the best point that it noted."""


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
class Watch:
    """Clock of a solve: its parts, and the cost at each iteration."""

    limit_s: float
    start: float = field(default_factory=perf_counter)
    seconds: dict[Part, float] = field(default_factory=lambda: {"build": 0.0, "evaluation": 0.0})
    trace: list[tuple[float, float]] = field(default_factory=list)
    """(seconds since the start, cost) at each iteration"""
    best: tuple[float, Array] | None = None
    """Least cost that was noted, and where"""
    end: float | None = None
    """When the solution was reached"""
    callback_s: float = 0.0
    """Part of the evaluation that went through callbacks written in Python"""
    stream: Path | None = None
    """File to which the trace is also written as it grows: what is left of a process that dies"""

    @contextmanager
    def part(self, name: Part) -> Iterator[None]:
        """Seconds of the block count as that part."""
        begin = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += perf_counter() - begin

    @contextmanager
    def callback(self) -> Iterator[None]:
        """Seconds of an evaluation that a foreign library asked Python for."""
        begin = perf_counter()
        try:
            yield
        finally:
            spent = perf_counter() - begin
            self.seconds["evaluation"] += spent
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

    def note(self, cost: float, x: Array | None = None) -> None:
        """One iteration ended at this cost."""
        self.trace.append((self.elapsed(), float(cost)))
        if x is not None and (self.best is None or cost < self.best[0]):
            self.best = (float(cost), x.copy())
        if self.stream is not None:
            with self.stream.open("a") as file:
                file.write(f"{self.trace[-1][0]:.6f} {cost:.17g}\n")

    def check(self) -> None:
        """Raises OutOfTime when the limit is passed."""
        if self.left() <= 0.0:
            raise OutOfTime


class Solver(Protocol):
    """One method; a new object for each solve."""

    name: str
    family: str
    """Whose work it is: ours, ipopt, gtsam, ..."""
    claim: Claim
    words: str
    """What it is, in a few words"""
    needs: tuple[str, ...]
    """Packages beyond those that polhode always has"""

    def solve(self, problem: MeasuredProblem, x: Array, watch: Watch) -> Outcome:
        """Minimise from x (n,). Raises OutOfTime at the limit; any other error is a failed row."""
        ...
