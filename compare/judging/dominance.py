"""Whether a solver is on the Pareto front of time against accuracy, and who beats it where it is not."""

from collections.abc import Sequence
from dataclasses import dataclass

from polhode.compare.judging.judge import AGREED
from polhode.compare.tables.rows import Comparison, Row
from polhode.compare.tables.table import gap

NOISE = 0.1
"""Times that differ by no more than this share count as equal."""


@dataclass(frozen=True)
class Standing:
    """One solver on one problem, from the cold start."""

    problem: str
    row: Row | None
    """None: it was not run"""
    beaten_by: tuple[Row, ...]
    """Not slower and more accurate, or faster and not less accurate; by time"""

    @property
    def on_front(self) -> bool:
        """It ended, and nobody beats it."""
        return self.row is not None and self.row.status == "ok" and not self.beaten_by


def standings(comparison: Comparison, solver: str) -> list[Standing]:
    """One for each problem."""
    out = []
    for problem in comparison.problems:
        rows = [row for row in comparison.rows if row.problem == problem.name and row.start == "cold"]
        own = next((row for row in rows if row.solver == solver), None)
        others = [row for row in rows if row is not own and row.status in ("ok", "baseline")]
        better = [row for row in others if own is not None and beats(row, own, problem.least_cost)]
        better.sort(key=lambda row: row.wall_s or 0.0)
        out.append(Standing(problem.name, own, tuple(better)))
    return out


def beats(row: Row, other: Row, least: float | None) -> bool:
    """Costs within ``AGREED`` of the least are equally accurate, times within ``NOISE`` equally long.

    Who did not end is beaten by all who did.
    """
    if row.wall_s is None or row.cost is None:
        return False
    if other.wall_s is None or other.status not in ("ok", "baseline"):
        return True
    over, over_other = (max(gap(one, least) or 0.0, AGREED) for one in (row, other))
    faster = (1.0 + NOISE) * row.wall_s < other.wall_s
    as_fast = row.wall_s <= (1.0 + NOISE) * other.wall_s
    return (faster and over <= over_other) or (as_fast and over < over_other)


def standing_lines(found: Sequence[Standing], solver: str) -> list[str]:
    """A table, and a sentence before it."""
    n = sum(each.on_front for each in found)
    head = (
        f"{solver}, the default: on the front of time against accuracy on {n} of {len(found)} problems "
        f"(cold starts; times within {NOISE:.0%} and costs within {AGREED:g} count as equal)"
    )
    lines = [head, "| problem | status | time s | on the front | beaten by |", "|" + "---|" * 5]
    for each in found:
        row = each.row
        if row is None:
            lines.append(f"| {each.problem} | not run | | | |")
            continue
        time = "" if row.wall_s is None else f"{row.wall_s:.2f}"
        # the fastest few say enough
        names = [f"{one.solver} ({one.wall_s or 0.0:.2f} s)" for one in each.beaten_by[:3]]
        more = [f"{len(each.beaten_by) - 3} more"] if len(each.beaten_by) > 3 else []
        told = "yes" if each.on_front else "no"
        lines.append(f"| {each.problem} | {row.status} | {time} | {told} | {', '.join([*names, *more])} |")
    return lines
