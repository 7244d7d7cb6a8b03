"""compare.html: one page that needs no other file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from polhode.compare.problem.assessment import AGREED
from polhode.compare.rows import Comparison, ProblemSummary, Row
from polhode.compare.tables import (
    COLUMNS,
    ERROR_COLUMNS,
    cells,
    curve,
    error_cells,
    start_text,
    tally_text,
    verdict,
)
from polhode.files.atomic import write_text
from polhode.report.plot_style import Figure, Trace, axis, layout, line
from polhode.report.template import fill

COLORS = (
    "#0072b2", "#d55e00", "#cc79a7", "#22303c", "#56b4e9", "#b8860b", "#5b3f8c", "#8a97a3", "#8c564b",
    "#a05195",
)  # fmt: skip
"""Colours of the solvers in their order; the pattern of the line changes after the last one."""
MAX_TRACES = 12
"""Largest number of problems whose figures are drawn."""


def write_page(comparison: Comparison, path: Path) -> None:
    """Cost against time, performance profiles, the tables."""
    names = list(dict.fromkeys(row.solver for row in comparison.rows))
    colors = {name: (COLORS[n % 10], ("solid", "dash", "dot")[n // 10 % 3]) for n, name in enumerate(names)}
    drawn = [(n, problem, _rows_of(comparison, problem)) for n, problem in enumerate(comparison.problems)]
    figures = [
        *(_cost_against_time(n, problem, rows, colors) for n, problem, rows in drawn[:MAX_TRACES]),
        _profiles(comparison, colors),
    ]
    page = fill(
        "compare.html.j2",
        title="Optimizers side by side",
        comparison=comparison,
        figures=[figure for figure in figures if figure is not None],
        columns=COLUMNS,
        error_columns=ERROR_COLUMNS,
        tables=[_table(problem, rows) for _, problem, rows in drawn],
        successes=_success_rows(comparison),
    )
    write_text(path, page)


def _rows_of(comparison: Comparison, problem: ProblemSummary) -> list[Row]:
    return [row for row in comparison.rows if row.problem == problem.name]


def _table(problem: ProblemSummary, rows: list[Row]) -> dict[str, object]:
    return {
        "problem": problem,
        "rows": [(cells(row, problem.least_cost), row) for row in rows],
        "verdict": verdict(rows, problem.least_cost),
        "errors": [(row, start_text(row), error_cells(row.errors)) for row in rows if row.errors is not None],
    }


def _success_rows(comparison: Comparison) -> list[tuple[str, list[str]]]:
    if len({row.case for row in comparison.rows}) < 2:
        return []
    kinds = list(dict.fromkeys(row.start for row in comparison.rows))
    out = [("", [*(f"{kind} starts" for kind in kinds), "all"])]
    for each in comparison.profiles:
        found = [tally_text(each.starts[kind]) if kind in each.starts else "" for kind in kinds]
        out.append((each.solver, [*found, tally_text(each)]))
    return out


Colors = dict[str, tuple[str, str]]
"""Colour and pattern of each solver, the same in every figure."""


def _line(x: object, y: object, name: str, colors: Colors, label: str = "", shape: str = "linear") -> Trace:
    trace = line(np.asarray(x), np.asarray(y), label or name, colors[name][0])
    trace["line"] = {**trace["line"], "dash": colors[name][1], "shape": shape}
    if shape == "hv":
        trace["mode"] = "lines"
    return trace


def _figure(
    key: str, title: str, caption: str, data: Sequence[Trace], x: str, y: dict[str, Any], height: int
) -> Figure:
    drawing = layout(
        xaxis=axis(x, type="log"), yaxis=axis(**y), legend={"orientation": "v", "x": 1.01, "y": 1.0}
    )
    return Figure(key, title, caption, list(data), drawing, height)


def _cost_against_time(n: int, problem: ProblemSummary, rows: list[Row], colors: Colors) -> Figure | None:
    # the trace of a baseline is its own cost, of the frames so far
    rows = [row for row in rows if row.trace and row.claim == "ok"]
    if problem.least_cost is None or not rows:
        return None
    data = []
    for row in rows:
        if row.case == rows[0].case:
            seconds, cost = np.array(row.trace).T
            over = np.maximum(cost / problem.least_cost - 1.0, 1e-12)
            data.append(_line(np.maximum(seconds, 1e-3), over, row.solver, colors))
    caption = (
        f"{rows[0].start.capitalize()} start. Cost over the least one found, minus 1, at each iteration; a "
        f"line begins when the solver is built. Below {AGREED:g} solvers agree."
    )
    y = {"title": "cost over the least - 1", "type": "log", "exponentformat": "power"}
    return _figure(f"cost{n}", f"Cost against time, {problem.name}", caption, data, "seconds", y, 480)


def _profiles(comparison: Comparison, colors: Colors) -> Figure | None:
    cases = {row.case for row in comparison.rows}
    if len(cases) < 2:
        return None
    data = [
        _line(*curve(each), each.solver, colors, f"{each.solver}: {tally_text(each)}", "hv")
        for each in comparison.profiles
        if each.ran
    ]
    caption = (
        f"{len(cases)} cases (problems and starts). For each solver the share of the cases it ran (the "
        "legend has their number) that it solved within a factor of the fastest solver's time (Dolan and "
        "Moré 2002). Solved: it claims convergence at the least cost known. A case that did not run (package "
        "missing, or no time left) counts neither for nor against it; baselines claim no convergence "
        "and have no profile."
    )
    y = {"title": "share of the cases it ran", "range": [-0.02, 1.04]}
    return _figure("profiles", "Performance profiles", caption, data, "time over the fastest", y, 460)
