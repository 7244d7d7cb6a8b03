"""Performance profiles and the tables of a comparison: at the terminal, and as CSV."""

import csv
import io
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from polhode.compare.problem.assessment import AGREED
from polhode.compare.rows import Comparison, EstimateErrors, Profile, Row, Tally, gap, least_costs
from polhode.geometry.lie import Array


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


COLUMNS = (
    "solver", "start", "status", "over least", "iter", "time s", "MB",
    "sigma k1", "sigma k2",
)  # fmt: skip
ERROR_COLUMNS = ("r mm", "v mm/s", "attitude deg", "w deg/s", "com mm", "k1", "k2")


def format_tables(comparison: Comparison) -> str:
    """A table for each problem, a sentence on the agreement of the solvers, and which were left out."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=132)
    with console.capture() as printed:
        for problem in comparison.problems:
            rows = [row for row in comparison.rows if row.problem == problem.name]
            title = (
                f"{problem.name}: {problem.frames} frames, {problem.landmarks} landmarks, "
                f"{problem.observations} observations"
            )
            console.print(_table(title, COLUMNS, [cells(row, problem.least_cost) for row in rows]))
            errors = [
                [row.solver, start_text(row), row.status, *error_cells(row.errors)]
                for row in rows
                if row.errors is not None
            ]
            if errors:
                title = "Estimate minus truth, at the point that is kept"
                console.print(_table(title, (*COLUMNS[:3], *ERROR_COLUMNS), errors))
            ended = [
                f"  {row.solver} ({row.start} {row.seed}): {row.message}"
                for row in rows
                if row.status in ("failed", "timeout", "missing")
            ]
            console.print("\n".join([*ended, verdict(rows, problem.least_cost)]), markup=False)
        for text in tallies(comparison):
            console.print(text, markup=False)
    return printed.get().rstrip("\n")


def _table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, justify="left" if column in COLUMNS[:3] else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def cells(row: Row, least: float | None) -> list[str]:
    """The row in the order of ``COLUMNS``."""

    def number(value: float | None, form: str) -> str:
        return "" if value is None else format(value, form)

    return [
        *(row.solver, start_text(row), row.status, number(gap(row, least), ".1e")),
        *(number(row.iterations, "d"), number(row.wall_s, ".2f"), number(row.memory_mb, ".0f")),
        *(number(row.sigma_k1, ".2e"), number(row.sigma_k2, ".2e")),
    ]


def error_cells(errors: EstimateErrors) -> list[str]:
    """Estimate minus truth, in the order of ``ERROR_COLUMNS``."""
    forms = (".2f", ".2f", ".3f", ".3f", ".2f", "+.4f", "+.4f")
    return [format(value, form) for (_, value), form in zip(errors, forms, strict=True)]


def start_text(row: Row) -> str:
    """Kind of start, and its seed."""
    return row.start if row.start == "cold" else f"{row.start} {row.seed}"


def tallies(comparison: Comparison) -> list[str]:
    """Cases solved of those that were run, by kind of start; nothing for a single case."""
    if len({row.case for row in comparison.rows}) < 2:
        return []
    return [
        f"  {each.solver}: solved "
        + ", ".join(f"{kind} {tally_text(tally)}" for kind, tally in each.starts.items())
        for each in comparison.profiles
    ]


def tally_text(tally: Tally) -> str:
    """As in "3 of 5 (2 not run)"."""
    return f"{tally.solved} of {tally.ran}" + (f" ({tally.not_run} not run)" if tally.not_run else "")


def verdict(rows: Sequence[Row], least: float | None) -> str:
    """Largest difference of the costs of those that claim convergence, and the fastest of them."""
    good = [row for row in rows if row.status == "ok"]
    if not good or least is None:
        return "No solver claims convergence."
    worst = max(good, key=lambda row: row.cost or 0.0)
    fastest = min(good, key=lambda row: row.wall_s or float("inf"))
    claim = "rows claim" if len(good) > 1 else "row claims"
    return (
        f"{len(good)} {claim} convergence, {gap(worst, least):.1e} of the least cost apart at most "
        f"({worst.solver}); the fastest: {fastest.solver}, {fastest.wall_s:.2f} s."
    )


def csv_text(rows: Sequence[Row]) -> str:
    """All rows, one line each, without the traces."""
    stream = io.StringIO()
    names = [name for name in Row.model_fields if name not in ("trace", "errors")]
    names += [f"error_{name}" for name in EstimateErrors.model_fields]
    writer = csv.DictWriter(stream, names, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        errors = {} if row.errors is None else {f"error_{name}": value for name, value in row.errors}
        writer.writerow({**row.model_dump(), **errors})
    return stream.getvalue()
