"""One page for several runs: what each found, their inertia ratios and rates in common drawings, a table."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from polhode.files.atomic import write_text
from polhode.files.output.single_file import make_parent
from polhode.report import tables
from polhode.report.page import run_name
from polhode.report.plot_style import TIME_TITLE, Figure, Trace, axis, layout, line
from polhode.report.polhode_and_inertia_figures import possible_bodies, ratio_ellipse, ratio_traces
from polhode.report.template import fill
from polhode.run_directory.run_folder import require_run_folder
from polhode.run_directory.stored_run import StoredRun, read_stored_run

RUN_COLORS: tuple[str, ...] = ("#0072b2", "#d55e00", "#cc79a7", "#22303c", "#56b4e9", "#b8860b")
SYMBOLS: tuple[str, ...] = ("circle", "square", "diamond", "triangle-up", "cross", "star", "hexagon")
"""Colours and marks of the runs, used cyclically; their numbers differ, so that pairs repeat late."""
NO_VALUE = "\u2013"


def write_comparison(folders: Sequence[Path], path: Path) -> None:
    """Write one page about several runs. Raises InputError when a folder is not a run."""
    for folder in folders:
        require_run_folder(folder)
    names = [run_name(folder) for folder in folders]
    # Two folders of the same name are distinguished by their paths.
    names = [
        name if names.count(name) == 1 else str(folder) for name, folder in zip(names, folders, strict=True)
    ]
    contents = [read_stored_run(folder, name) for folder, name in zip(folders, names, strict=True)]
    runs = []
    for content in contents:
        words = tables.finding(content.summary, content.motion.trajectory if content.motion else None)
        runs.append({"name": content.name, "status": content.summary.status, "finding": words})
    rows = {"runs": runs, "figures": _figures(contents), "table": side_by_side(contents)}
    page = fill("comparison.html.j2", title=", ".join(names), **rows)
    make_parent(path, path)
    write_text(path, page)


def side_by_side(contents: Sequence[StoredRun]) -> list[tuple[str, list[str]]]:
    """(quantity, one cell per run) of every number that any of the runs has, in the order of the report."""
    columns = []
    for content in contents:
        # The frame G is each run's own: places in it cannot be compared.
        inertia = tables.inertia_rows(content.summary)
        comparable = [row for row in inertia if not row.name.startswith("centre of mass, ")]
        rows = [*comparable, *tables.motion_rows(content), *tables.run_rows(content)]
        cells = {row.name: f"{row.value} {row.unit}".strip() for row in rows}
        cells |= {f"time, {stage}": f"{s:.1f} s" for stage, s, _ in tables.timing_rows(content.summary)}
        metrics = tables.metric_rows(content.metrics)
        columns.append(cells | {f"against the truth: {row.name}": row.value for row in metrics})
    names = list(dict.fromkeys(name for column in columns for name in column))
    return [(name, [column.get(name, NO_VALUE) for column in columns]) for name in names]


def _figures(contents: Sequence[StoredRun]) -> list[Figure]:
    """k1 and k2 with their ellipses, and the magnitude of the angular velocity, where runs have them."""
    ratios: list[Trace] = []
    rates: list[Trace] = []
    points = []
    for k, content in enumerate(contents):
        inertia, color = content.summary.inertia, RUN_COLORS[k % len(RUN_COLORS)]
        if inertia is not None:
            ratios += ratio_traces(inertia, content.name, color)
            ellipse = ratio_ellipse(inertia)
            points.append(np.array([[inertia.k1, inertia.k2]]) if ellipse is None else ellipse)
        if content.motion is not None:
            path = content.motion.trajectory
            rate = np.rad2deg(np.linalg.norm(path.w_P, axis=1))
            curve = line(path.time_s, rate, content.name, color)
            curve["marker"] |= {"symbol": SYMBOLS[k % len(SYMBOLS)], "size": 5}
            rates.append(curve)
    figures = []
    if points:
        low, high = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
        pad = np.maximum(0.15 * (high - low), 0.01)
        x_range, y_range = np.stack([low - pad, high + pad], axis=1).tolist()
        x = axis("k<sub>1</sub> = ln(Jxx / Jyy)", range=x_range)
        drawing = layout(xaxis=x, yaxis=axis("k<sub>2</sub> = ln(Jyy / Jzz)", range=y_range))
        words = (
            "Dots: estimates; ellipses: three standard deviations; an open dot has none, because the motion "
            "of that run does not determine the ratios. Grey: where rigid bodies can lie."
        )
        figures.append(
            Figure("ratios", "Inertia ratios", words, [possible_bodies(1), *ratios], drawing, 460, False)
        )
    if rates:
        drawing = layout(xaxis=axis(TIME_TITLE), yaxis=axis("angular velocity, magnitude [deg/s]"))
        words = (
            "Its magnitude is the same in every frame and for every choice of axes, so runs can be compared."
        )
        figures.append(Figure("rates", "Angular velocity", words, rates, drawing, 460, False))
    return figures
