"""Statistics over the rows: performance profiles, growth with size, Pareto front, success over starts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polhode.compare.problem.assessment import AGREED
from polhode.compare.rows import Comparison, Profile, Row, Tally, gap, least_costs
from polhode.geometry.lie import Array

FINISHED = ("ok", "baseline")
NOISE = 0.1
"""Relative difference of times up to which they count as equal."""


def solved(row: Row, least: float | None) -> bool:
    """Whether it claims convergence at the least known cost of its problem."""
    over = gap(row, least)
    return row.status == "ok" and over is not None and over <= AGREED


def performance_profiles(comparison: Comparison) -> list[Profile]:
    """A profile for each solver that claims convergence, over the cases that it ran."""
    least, fastest = least_costs(comparison), dict[tuple[str, str, int], float]()
    rows = [row for row in comparison.rows if row.claim == "ok"]
    good = [row for row in rows if solved(row, least[row.problem])]
    for row in good:
        fastest[row.case] = min(fastest.get(row.case, np.inf), row.wall_s or 0.0)

    def tally(own: Sequence[Row]) -> Tally:
        ran = [row for row in own if row.ran]
        won = sum(solved(row, least[row.problem]) for row in ran)
        return Tally(solved=won, ran=len(ran), not_run=len(own) - len(ran))

    out = []
    for solver in dict.fromkeys(row.solver for row in rows):
        own = [row for row in rows if row.solver == solver]
        factors = [(row.wall_s or 0.0) / max(fastest[row.case], 1e-9) for row in good if row.solver == solver]
        kinds = dict.fromkeys(row.start for row in own)
        starts = {kind: tally([row for row in own if row.start == kind]) for kind in kinds}
        out.append(Profile(solver=solver, starts=starts, factors=sorted(factors), **tally(own).model_dump()))
    return out


def curve(profile: Profile) -> tuple[Array, Array]:
    """Factors of time (n,) from 1 to at least 100, and the share of the cases solved within them (n,)."""
    factors = np.array(profile.factors)
    share = np.arange(1, len(factors) + 1) / max(profile.ran, 1)
    return (
        np.concatenate([[1.0], factors, [max([100.0, *factors])]]),
        np.concatenate([[0.0], share, share[-1:] if len(share) else [0.0]]),
    )


@dataclass(frozen=True)
class Growth:
    """Time of a solver over the number of observations; time ~ size^exponent."""

    solver: str
    size: Array
    """(n,) observations, by number of frames"""
    seconds: Array
    exponent: float


def growths(comparison: Comparison) -> list[Growth]:
    """Growth of the solvers that solved problems of three numbers of frames, over a factor of two in size.

    From the cold start; medians over problems with equally many frames. The size is the number of
    observations, as landmarks that are seen repeatedly add no unknowns.
    """
    problems = {problem.name: problem for problem in comparison.problems}
    least, out = least_costs(comparison), []
    for solver in dict.fromkeys(row.solver for row in comparison.rows):
        of_size: dict[int, list[tuple[int, float]]] = {}
        for row in comparison.rows:
            good = row.solver == solver and row.start == "cold" and row.wall_s is not None
            if good and solved(row, least[row.problem]):
                problem = problems[row.problem]
                of_size.setdefault(problem.frames, []).append((problem.observations, row.wall_s or 0.0))
        if len(of_size) < 3:
            continue
        size, seconds = np.array([np.median(of_size[n], axis=0) for n in sorted(of_size)]).T
        if size[-1] >= 2.0 * size[0]:
            out.append(Growth(solver, size, seconds, float(np.polyfit(np.log(size), np.log(seconds), 1)[0])))
    return out


def front(rows: Sequence[Row], least: float | None) -> list[Row]:
    """Rows of one problem on the Pareto front of time and accuracy, by time: no other row beats them."""
    finished = [row for row in rows if row.status in FINISHED and row.wall_s is not None]
    best = [row for row in finished if not any(beats(other, row, least) for other in finished)]
    return sorted(best, key=lambda row: row.wall_s or 0.0)


def beats(row: Row, other: Row, least: float | None) -> bool:
    """Whether it is not slower and more accurate, or faster and not less accurate.

    Costs within ``AGREED`` of the least are equally accurate, times within ``NOISE`` equally long. A row that
    did not finish is beaten by all that did, and beats none.
    """
    if row.wall_s is None or row.cost is None or row.status not in FINISHED:
        return False
    if other.wall_s is None or other.status not in FINISHED:
        return True
    over, over_other = (max(gap(one, least) or 0.0, AGREED) for one in (row, other))
    faster = (1.0 + NOISE) * row.wall_s < other.wall_s
    as_fast = row.wall_s <= (1.0 + NOISE) * other.wall_s
    return (faster and over <= over_other) or (as_fast and over < over_other)
