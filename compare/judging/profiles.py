"""What many rows say together: performance profiles, growth, the Pareto front, success over starts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polhode.compare.judging.dominance import beats
from polhode.compare.judging.judge import AGREED
from polhode.compare.tables.rows import Comparison, Profile, Row, Tally
from polhode.compare.tables.table import gap, least_costs
from polhode.lie import Array

Case = tuple[str, str, int]
"""Problem, start, seed."""
LONGEST = 100.0
"""Largest factor of time in a profile."""
FEWEST_SIZES, LEAST_RANGE = 3, 2.0
"""Sizes that an exponent is fitted to, and the largest over the smallest of them."""


def solved(row: Row, least: float | None) -> bool:
    """It claims convergence and is at the least cost known of its problem."""
    over = gap(row, least)
    return row.status == "ok" and over is not None and over <= AGREED


def performance_profiles(comparison: Comparison) -> list[Profile]:
    """One for each solver that claims convergence. What did not run counts neither for nor against it."""
    least = least_costs(comparison)
    rows = [row for row in comparison.rows if row.claim == "ok"]
    fastest: dict[Case, float] = {}
    for row in rows:
        if solved(row, least[row.problem]):
            fastest[_case(row)] = min(fastest.get(_case(row), np.inf), row.wall_s or 0.0)
    out = []
    for solver in dict.fromkeys(row.solver for row in rows):
        own = [row for row in rows if row.solver == solver]
        good = [row for row in own if solved(row, least[row.problem])]
        factors = sorted((row.wall_s or 0.0) / max(fastest[_case(row)], 1e-9) for row in good)
        kinds = dict.fromkeys(row.start for row in own)
        starts = {kind: _tally([row for row in own if row.start == kind], least) for kind in kinds}
        out.append(Profile(solver=solver, starts=starts, factors=factors, **_tally(own, least).model_dump()))
    return out


def curve(profile: Profile) -> tuple[Array, Array]:
    """Factors of time (n,) from 1, and the share of the cases it ran that it solved within them (n,)."""
    factors = np.array(profile.factors)
    share = np.arange(1, len(factors) + 1) / max(profile.ran, 1)
    return (
        np.concatenate([[1.0], factors, [max([LONGEST, *factors])]]),
        np.concatenate([[0.0], share, share[-1:] if len(share) else [0.0]]),
    )


def _case(row: Row) -> Case:
    return row.problem, row.start, row.seed


def _tally(rows: Sequence[Row], least: dict[str, float | None]) -> Tally:
    ran = [row for row in rows if row.ran]
    good = sum(solved(row, least[row.problem]) for row in ran)
    return Tally(solved=good, ran=len(ran), not_run=len(rows) - len(ran))


@dataclass(frozen=True)
class Growth:
    """Time of a solver over the number of observations; time ~ size^exponent."""

    solver: str
    size: Array
    """(n,) observations, by number of frames"""
    seconds: Array
    exponent: float


def growths(comparison: Comparison) -> list[Growth]:
    """Of the solvers that solved problems of three numbers of frames or more, cold; medians where these are
    equal. The size is the number of observations: landmarks seen again and again add no unknowns."""
    problems = {problem.name: problem for problem in comparison.problems}
    least, out = least_costs(comparison), []
    for solver in dict.fromkeys(row.solver for row in comparison.rows):
        of_size: dict[int, list[tuple[int, float]]] = {}
        for row in comparison.rows:
            good = row.solver == solver and row.start == "cold" and row.wall_s is not None
            if good and solved(row, least[row.problem]):
                problem = problems[row.problem]
                of_size.setdefault(problem.frames, []).append((problem.observations, row.wall_s or 0.0))
        if len(of_size) < FEWEST_SIZES:
            continue
        size, seconds = np.array([np.median(of_size[n], axis=0) for n in sorted(of_size)]).T
        if size[-1] < LEAST_RANGE * size[0]:
            continue
        out.append(Growth(solver, size, seconds, float(np.polyfit(np.log(size), np.log(seconds), 1)[0])))
    return out


def front(rows: Sequence[Row], least: float | None) -> list[Row]:
    """The Pareto front of time against accuracy, by time: the rows of one problem that none other beats."""
    ended = [row for row in rows if row.status in ("ok", "baseline") and row.wall_s is not None]
    kept = [row for row in ended if not any(beats(other, row, least) for other in ended if other is not row)]
    return sorted(kept, key=lambda row: row.wall_s or 0.0)
