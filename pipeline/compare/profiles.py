"""What many rows say together: performance profiles, growth, the Pareto front, success over starts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.compare.judge import AGREED
from pipeline.compare.rows import Comparison, Row
from pipeline.compare.table import gap, least_cost
from polhode.lie import Array

LONGEST = 100.0
"""Largest factor of time in a profile."""
FEWEST_SIZES, LEAST_RANGE = 3, 2.0
"""Sizes that an exponent is fitted to, and the largest over the smallest of them."""


def solved(row: Row, least: float | None) -> bool:
    """It claims convergence and is at the least cost known of its problem."""
    over = gap(row, least)
    return row.status == "ok" and over is not None and over <= AGREED


@dataclass(frozen=True)
class Profile:
    """Share of the cases that a solver solved within a factor of the fastest one's time (Dolan, Moré)."""

    solver: str
    factor: Array
    """(n,) ascending, from 1"""
    share: Array
    """(n,) 0..1"""


def performance_profiles(comparison: Comparison) -> list[Profile]:
    """One for each solver, over all cases (problem, start, seed) that any of them solved."""
    least = {problem.name: least_cost(comparison.rows, problem.name) for problem in comparison.problems}
    times: dict[str, dict[tuple[str, str, int], float]] = {}
    for row in comparison.rows:
        of_solver = times.setdefault(row.solver, {})
        if solved(row, least[row.problem]) and row.wall_s is not None:
            of_solver[(row.problem, row.start, row.seed)] = row.wall_s
    cases = sorted({case for of_solver in times.values() for case in of_solver})
    fastest = {
        case: min(of_solver[case] for of_solver in times.values() if case in of_solver) for case in cases
    }
    out = []
    for solver, of_solver in times.items():
        factors = np.sort([of_solver[case] / fastest[case] for case in cases if case in of_solver])
        share = np.arange(1, len(factors) + 1) / max(len(cases), 1)
        out.append(
            Profile(
                solver,
                np.concatenate([[1.0], factors, [max([LONGEST, *factors])]]),
                np.concatenate([[0.0], share, share[-1:] if len(share) else [0.0]]),
            )
        )
    return out


@dataclass(frozen=True)
class Growth:
    """Time of a solver over the number of unknowns; time ~ size^exponent."""

    solver: str
    size: Array
    seconds: Array
    exponent: float


def growths(comparison: Comparison) -> list[Growth]:
    """Of the solvers that solved problems of three sizes or more, cold; medians where sizes are equal."""
    sizes = {problem.name: problem.unknowns for problem in comparison.problems}
    least = {problem.name: least_cost(comparison.rows, problem.name) for problem in comparison.problems}
    out = []
    for solver in dict.fromkeys(row.solver for row in comparison.rows):
        of_size: dict[int, list[float]] = {}
        for row in comparison.rows:
            good = row.solver == solver and row.start == "cold" and row.wall_s is not None
            if good and solved(row, least[row.problem]):
                of_size.setdefault(sizes[row.problem], []).append(float(row.wall_s or 0.0))
        if len(of_size) < FEWEST_SIZES or max(of_size) < LEAST_RANGE * min(of_size):
            continue
        size = np.array(sorted(of_size), dtype=np.float64)
        seconds = np.array([np.median(of_size[int(n)]) for n in size])
        out.append(Growth(solver, size, seconds, float(np.polyfit(np.log(size), np.log(seconds), 1)[0])))
    return out


def front(rows: Sequence[Row]) -> list[Row]:
    """The Pareto front of time against accuracy among the rows of one problem, by time.

    Accuracy is the cost over the least one; below ``AGREED`` all are equally accurate.
    """
    least = min((row.cost for row in rows if row.cost is not None), default=None)
    ended = [row for row in rows if row.status in ("ok", "baseline") and row.wall_s is not None]
    out: list[Row] = []
    best = np.inf
    for row in sorted(ended, key=lambda row: row.wall_s or 0.0):
        over = max(gap(row, least) or 0.0, AGREED)
        if over < best:
            out.append(row)
            best = over
    return out


def successes(comparison: Comparison) -> dict[str, dict[str, tuple[int, int]]]:
    """By solver and kind of start: how many of how many were solved."""
    least = {problem.name: least_cost(comparison.rows, problem.name) for problem in comparison.problems}
    out: dict[str, dict[str, tuple[int, int]]] = {}
    for row in comparison.rows:
        of_solver = out.setdefault(row.solver, {})
        done, tried = of_solver.get(row.start, (0, 0))
        of_solver[row.start] = (done + solved(row, least[row.problem]), tried + 1)
    return out
