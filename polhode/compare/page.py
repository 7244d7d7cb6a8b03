"""compare.html: one page that needs no other file."""

from pathlib import Path
from typing import Any

import numpy as np

from polhode.compare.problem.assessment import AGREED
from polhode.compare.ranking import NOISE, curve, front, growths
from polhode.compare.rows import Comparison, ProblemSummary, Row, gap
from polhode.compare.tables import (
    COLUMNS,
    ERROR_COLUMNS,
    cells,
    error_cells,
    not_separable,
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
DASHES = ("solid", "dash", "dot")
LEGEND = {"orientation": "v", "x": 1.01, "y": 1.0}
FLOOR = 1e-12
"""Smallest relative distance from the least cost that is drawn."""
MAX_TRACES = 12
"""Largest number of problems whose figures are drawn."""


def write_page(comparison: Comparison, path: Path) -> None:
    """Cost against time, performance profiles, growth, time against accuracy, the tables."""
    names = list(dict.fromkeys(row.solver for row in comparison.rows))
    drawn = comparison.problems[:MAX_TRACES]
    figures = [
        *(_cost_against_time(comparison, problem, names, number) for number, problem in enumerate(drawn)),
        _profiles(comparison, names),
        _growth(comparison, names),
        *(_time_against_accuracy(comparison, problem, names, number) for number, problem in enumerate(drawn)),
    ]
    page = fill(
        "compare.html.j2",
        title="Optimizers side by side",
        comparison=comparison,
        figures=[figure for figure in figures if figure is not None],
        columns=COLUMNS,
        error_columns=ERROR_COLUMNS,
        tables=[_table(comparison, problem) for problem in comparison.problems],
        successes=_success_rows(comparison),
    )
    write_text(path, page)


def _table(comparison: Comparison, problem: ProblemSummary) -> dict[str, object]:
    rows = [row for row in comparison.rows if row.problem == problem.name]
    least = problem.least_cost
    return {
        "problem": problem,
        "rows": [(cells(row, least), row) for row in rows],
        "verdict": verdict(rows, least),
        "not_separable": not_separable(rows),
        "errors": [(row, start_text(row), error_cells(row.errors)) for row in rows if row.errors is not None],
    }


def _success_rows(comparison: Comparison) -> list[tuple[str, list[str]]]:
    if len({(row.problem, row.start, row.seed) for row in comparison.rows}) < 2:
        return []
    kinds = list(dict.fromkeys(row.start for row in comparison.rows))
    out = [("", [*(f"{kind} starts" for kind in kinds), "all"])]
    for each in comparison.profiles:
        cells = [tally_text(each.starts[kind]) if kind in each.starts else "" for kind in kinds]
        out.append((each.solver, [*cells, tally_text(each)]))
    return out


def style(name: str, names: list[str]) -> tuple[str, str]:
    """Colour and pattern of a solver, the same in every figure."""
    number = names.index(name)
    return COLORS[number % len(COLORS)], DASHES[number // len(COLORS) % len(DASHES)]


def _line(x: object, y: object, name: str, names: list[str], **more: Any) -> Trace:
    color, dash = style(name, names)
    trace = line(np.asarray(x), np.asarray(y), name, color, **more)
    trace["line"] = {**trace["line"], "dash": dash}
    return trace


def _cost_against_time(
    comparison: Comparison, problem: ProblemSummary, names: list[str], number: int
) -> Figure | None:
    least = problem.least_cost
    # the trace of a baseline is its own cost, of the frames so far
    rows = [row for row in comparison.rows if row.problem == problem.name and row.trace and row.claim == "ok"]
    if least is None or not rows:
        return None
    kind = rows[0].start
    data = []
    for row in rows:
        if row.start != kind or row.seed != rows[0].seed:
            continue
        points = np.array(row.trace)
        over = np.maximum(points[:, 1] / least - 1.0, FLOOR)
        data.append(_line(np.maximum(points[:, 0], 1e-3), over, row.solver, names))
    caption = (
        f"{kind.capitalize()} start. Cost over the least one found, minus 1, at each iteration; a line "
        f"begins when the solver is built. Below {AGREED:g} solvers agree. Formulations with slack show the "
        "cost of their slack instead of the common cost until the constraints are satisfied."
    )
    drawing = layout(
        xaxis=axis("seconds", type="log"),
        yaxis=axis("cost over the least - 1", type="log", exponentformat="power"),
        legend=LEGEND,
    )
    return Figure(f"cost{number}", f"Cost against time, {problem.name}", caption, data, drawing, 480)


def _profiles(comparison: Comparison, names: list[str]) -> Figure | None:
    cases = {(row.problem, row.start, row.seed) for row in comparison.rows}
    if len(cases) < 2:
        return None
    data = []
    for profile in comparison.profiles:
        if not profile.ran:
            continue
        trace = _line(*curve(profile), profile.solver, names, mode="lines")
        trace["line"] = {**trace["line"], "shape": "hv"}
        trace["name"] = f"{profile.solver}: {tally_text(profile)}"
        data.append(trace)
    caption = (
        f"{len(cases)} cases (problems and starts). For each solver the share of the cases it ran (the "
        "legend has their number) that it solved within a factor of the fastest solver's time (Dolan and "
        "Moré 2002). Solved: it claims convergence at the least cost known. A case that did not run (package "
        "missing, or no time left) counts neither for nor against it; baselines claim no convergence "
        "and have no profile."
    )
    drawing = layout(
        xaxis=axis("time over the fastest", type="log"),
        yaxis=axis("share of the cases it ran", range=[-0.02, 1.04]),
        legend=LEGEND,
    )
    return Figure("profiles", "Performance profiles", caption, data, drawing, 460)


def _growth(comparison: Comparison, names: list[str]) -> Figure | None:
    found = growths(comparison)
    if not found:
        return None
    data = []
    for each in found:
        trace = _line(each.size, each.seconds, each.solver, names)
        trace["name"] = f"{each.solver}: n^{each.exponent:.2f}"
        data.append(trace)
    drawing = layout(
        xaxis=axis("observations", type="log"),
        yaxis=axis("seconds", type="log"),
        legend=LEGEND,
    )
    caption = "Cold starts that were solved; the exponent is fitted to all sizes."
    return Figure("growth", "Time against size", caption, data, drawing, 460)


def _time_against_accuracy(
    comparison: Comparison, problem: ProblemSummary, names: list[str], number: int
) -> Figure | None:
    rows = [row for row in comparison.rows if row.problem == problem.name and row.start == "cold"]
    least = problem.least_cost
    ended = [row for row in rows if row.status in ("ok", "baseline")]
    if not ended:
        return None
    data = [_point(row, least, names) for row in ended]
    best = front(rows, least)
    over = [max(gap(row, least) or 0.0, AGREED) for row in best]
    step = line(
        np.array([row.wall_s for row in best]), np.array(over), "Pareto front", "#8a97a3", mode="lines"
    )
    step["line"] = {**step["line"], "shape": "hv"}
    caption = (
        f"Cold start; costs within {AGREED:g} of the least count as equally accurate, times within "
        f"{NOISE:.0%} as equally long. On the front: "
        f"{', '.join(row.solver for row in best)}."
    )
    drawing = layout(
        xaxis=axis("seconds", type="log"),
        yaxis=axis("cost over the least - 1", type="log"),
        legend=LEGEND,
    )
    title = f"Time against accuracy, {problem.name}"
    return Figure(f"front{number}", title, caption, [step, *data], drawing, 420)


def _point(row: Row, least: float | None, names: list[str]) -> Trace:
    color, _ = style(row.solver, names)
    marker = {"color": color, "size": 9, "symbol": "circle" if row.status == "ok" else "diamond"}
    over = max(gap(row, least) or 0.0, AGREED)
    return line(np.array([row.wall_s]), np.array([over]), row.solver, color, mode="markers", marker=marker)
