"""The comparison at the terminal and as CSV."""

import csv
import io
from collections.abc import Sequence

from rich.console import Console, JustifyMethod
from rich.table import Table

from pipeline.compare.rows import Comparison, Row

COLUMNS = (
    "solver", "start", "status", "over least", "iter", "time s", "build", "eval", "linear", "MB",
    "sigma k1", "sigma k2",
)  # fmt: skip
WIDTH = 132
"""Characters of the table where no terminal says how many there are."""


def least_cost(rows: Sequence[Row], problem: str) -> float | None:
    """Of all rows of a problem."""
    costs = [row.cost for row in rows if row.problem == problem and row.cost is not None]
    return min(costs, default=None)


def gap(row: Row, least: float | None) -> float | None:
    """Cost over the least one of its problem, minus 1."""
    if row.cost is None or least is None:
        return None
    return row.cost / least - 1.0


def print_tables(comparison: Comparison) -> None:
    """A table for each problem, and a sentence on what agrees."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    for problem in comparison.problems:
        rows = [row for row in comparison.rows if row.problem == problem.name]
        least = least_cost(comparison.rows, problem.name)
        title = (
            f"{problem.name}: {problem.frames} frames, {problem.landmarks} landmarks, "
            f"{problem.observations} observations"
        )
        table = Table(title=title, title_justify="left")
        for column in COLUMNS:
            justify: JustifyMethod = "left" if column in COLUMNS[:3] else "right"
            table.add_column(column, justify=justify, no_wrap=True)
        for row in rows:
            table.add_row(*cells(row, least))
        console.print(table)
        notes = [row for row in rows if row.status in ("failed", "timeout", "missing")]
        for row in notes:
            console.print(f"  {row.solver} ({row.start} {row.seed}): {row.message}", markup=False)
        console.print(verdict(rows, least), markup=False)


def cells(row: Row, least: float | None) -> list[str]:
    """One row in words."""
    over = gap(row, least)
    return [
        row.solver,
        row.start if row.start == "cold" else f"{row.start} {row.seed}",
        row.status,
        "" if over is None else f"{over:.1e}",
        "" if row.iterations is None else str(row.iterations),
        *(_number(value, ".2f") for value in (row.wall_s, row.build_s, row.evaluation_s, row.linear_s)),
        _number(row.memory_mb, ".0f"),
        _number(row.sigma_k1, ".2e"),
        _number(row.sigma_k2, ".2e"),
    ]


def verdict(rows: Sequence[Row], least: float | None) -> str:
    """How far the costs of those that claim convergence are apart."""
    good = [row for row in rows if row.status == "ok"]
    if not good or least is None:
        return "No solver claims convergence."
    worst = max(good, key=lambda row: row.cost or 0.0)
    fastest = min(good, key=lambda row: row.wall_s or float("inf"))
    return (
        f"{len(good)} rows claim convergence, {gap(worst, least):.1e} of the least cost apart at most "
        f"({worst.solver}); the fastest: {fastest.solver}, {fastest.wall_s:.2f} s."
    )


def csv_text(rows: Sequence[Row]) -> str:
    """All rows, one line each; the trace stays in the JSON."""
    stream = io.StringIO()
    names = [name for name in Row.model_fields if name not in ("trace", "errors")]
    errors = ("position_mm", "velocity_mm_s", "attitude_deg", "angular_velocity_deg_s", "com_mm", "k1", "k2")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*names, *(f"error_{name}" for name in errors)])
    for row in rows:
        content = row.model_dump()
        told = content["errors"] or {}
        values = [*(content[name] for name in names), *(told.get(name) for name in errors)]
        writer.writerow(["" if value is None else value for value in values])
    return stream.getvalue()


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)
