"""The protocol of the adapters: what a solver gets, what it returns, and the record of its progress.

A solver runs in a process of its own that may be killed at any moment; its progress is written to files that
outlive it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, time
from typing import Literal, Protocol

import numpy as np

from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.rows import Kept
from polhode.geometry.lie import Array

Claim = Literal["ok", "baseline"]
"""Convergence on the common cost, or a result of another formulation."""
Part = Literal["build", "evaluation"]


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


class ProgressFiles:
    """Files of one solver's process: ``stem`` with the suffixes .log and .reached.

    A line of the log is a time, a cost after a number of seconds, or a status. The unknowns are in a
    memory-mapped file with two slots that are written in turn; the first number names the complete one. A
    write costs one copy, and a process that dies during it leaves the point before.
    """

    def __init__(self, stem: Path, n: int) -> None:
        """Create them, for points of n unknowns."""
        self._log = stem.with_suffix(".log")
        self._numbers = np.memmap(
            stem.with_suffix(".reached"), dtype=np.float64, mode="w+", shape=(1 + 2 * n,)
        )
        self._n = n
        self.write(f"started {time():.6f}")

    def point(self, x: Array, kind: Literal["best", "last"]) -> None:
        """Keep the unknowns (n,) instead of those before. Raises ValueError for another length."""
        slot = 1 if abs(self._numbers[0]) != 1.0 else 2
        at = 1 + (slot - 1) * self._n
        self._numbers[at : at + self._n] = x.reshape(self._n)
        self._numbers[0] = slot if kind == "best" else -slot

    def write(self, line: str) -> None:
        """Append a line to the log."""
        with self._log.open("a") as file:
            file.write(line + "\n")


@dataclass(frozen=True)
class ProcessProgress:
    """What a process that left no result had reached."""

    kept: Kept = "nothing"
    x: Array | None = None
    """(n,) the unknowns that were kept"""
    wall_s: float | None = None
    """Time since the solver's clock started [s]; None: the process ended before that"""
    trace: tuple[tuple[float, float], ...] = ()
    """Seconds and cost"""
    status: str = ""


def read_progress(stem: Path) -> ProcessProgress:
    """Read what ``ProgressFiles`` wrote; an incomplete last line is left out."""
    log, file = stem.with_suffix(".log"), stem.with_suffix(".reached")
    lines = log.read_text().splitlines(keepends=True) if log.is_file() else []
    entries = [line.rstrip("\n").partition(" ")[::2] for line in lines if line.endswith("\n")]
    started = [time() - float(text) for kind, text in entries if kind == "started"]
    costs = [text.split() for kind, text in entries if kind == "cost"]
    statuses = [text for kind, text in entries if kind == "status"]
    kept: Kept = "nothing"
    x = None
    numbers = np.fromfile(file) if file.is_file() else np.zeros(1)
    if slot := int(abs(numbers[0])):
        n, kept = (len(numbers) - 1) // 2, "best" if numbers[0] > 0.0 else "last"
        x = numbers[1 + (slot - 1) * n : 1 + slot * n]
    trace = tuple((float(seconds), float(cost)) for seconds, cost in costs)
    return ProcessProgress(kept, x, next(iter(started), None), trace, next(reversed(statuses), ""))


@dataclass
class SolveMonitor:
    """Clock of a solve: its parts, and the cost at each iteration."""

    limit_s: float
    start: float = field(default_factory=perf_counter)
    seconds: dict[Part, float] = field(default_factory=lambda: {"build": 0.0, "evaluation": 0.0})
    trace: list[tuple[float, float]] = field(default_factory=list)
    """(seconds since the start, cost) at each iteration"""
    best: tuple[float, Array] | None = None
    """Least common cost that was recorded, and its point"""
    last: Array | None = None
    """Last point of a method whose own cost during the iterations is not the common one"""
    end: float | None = None
    """When the solution was reached"""
    callback_s: float = 0.0
    """Spent in Python functions that a foreign library calls"""
    files: ProgressFiles | None = None
    """Where all this is also written, at once"""
    not_separable: str = ""
    """Why evaluation and linear algebra are not timed separately; empty: they are"""
    status: str = ""
    """Progress of a method that has no complete iterate before its end"""

    @contextmanager
    def part(self, name: Part) -> Iterator[None]:
        """Count the seconds of the block as that part."""
        begin = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += perf_counter() - begin

    @contextmanager
    def callback(self, part: Part | None = "evaluation") -> Iterator[None]:
        """Count the seconds that a foreign library spends in Python; None: in linear algebra of ours."""
        begin = perf_counter()
        try:
            yield
        finally:
            spent = perf_counter() - begin
            if part is not None:
                self.seconds[part] += spent
            self.callback_s += spent

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

    def record(self, cost: float, x: Array | None = None, common: bool = True) -> None:
        """Record an iteration that ended at this cost, with the common unknowns x (n,).

        ``common``: it is the common cost. If not, the last point is kept instead of the best.
        """
        self.trace.append((self.elapsed(), float(cost)))
        if self.files is not None:
            self.files.write("cost {:.6f} {:.17g}".format(*self.trace[-1]))
        if x is None or (common and not cost < (np.inf if self.best is None else self.best[0])):
            return
        if common:
            self.best = (float(cost), x.copy())
        else:
            self.last = x.copy()
        if self.files is not None:
            self.files.point(x, "best" if common else "last")

    def kept(self) -> tuple[Kept, Array | None]:
        """The point that is kept of a solver that did not finish."""
        if self.best is not None:
            return "best", self.best[1]
        return ("nothing", None) if self.last is None else ("last", self.last)

    def report(self, status: str) -> None:
        """Record the progress of a method that has no complete iterate before its end."""
        self.status = status
        if self.files is not None:
            self.files.write(f"status {status}")

    def check(self) -> None:
        """Raises OutOfTime when the limit is passed."""
        if self.left() <= 0.0:
            raise OutOfTime


class Solver(Protocol):
    """One method; a new object for each solve. ``registry`` describes it without importing it."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Minimise from x (n,). Raises OutOfTime at the limit; any other error is a failed row."""
        ...
