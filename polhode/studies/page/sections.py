"""The parts of the page: what each of them shows of a study, as rows and drawings for the template."""

from collections import defaultdict
from collections.abc import Sequence
from fnmatch import fnmatchcase
from itertools import combinations
from typing import Any

import numpy as np
import pyarrow as pa

from polhode.records.metrics import COVERAGE, COVERAGE_CONSTANTS, NEES
from polhode.report.plot_style import Figure
from polhode.studies.page.columns import Axis, Metric, texts, without_numbers
from polhode.studies.page.consistency import Consistency
from polhode.studies.page.drawings import (
    QUANTITIES,
    consistency_drawing,
    dependence,
    distribution,
    share_drawing,
    trade_off,
)
from polhode.studies.page.variance_shares import VarianceShares
from polhode.studies.steps import DONE, FAILED
from polhode.studies.store import Store

Row = dict[str, Any]
"""Of a table of the page: what the template names"""


def metric_parts(metrics: Sequence[Metric], axes: Sequence[Axis]) -> list[Row]:
    """Distribution and dependence on every axis of each metric."""
    parts = []
    for number, metric in enumerate(metrics):
        key = f"metric-{number}"
        figures = [distribution(metric, f"{key}-values")]
        figures += [dependence(metric, axis, f"{key}-{k}") for k, axis in enumerate(axes)]
        parts.append({"key": key, "metric": metric, "figures": figures, "is_open": number < 3})
    return parts


def outcome_figures(table: pa.Table, axes: Sequence[Axis]) -> list[Figure]:
    """The share of points that are done, with a run that is ok if they have one, along each axis; empty: all
    are, or none is."""
    verdicts, status = texts(table, "verdict"), texts(table, "status")
    good = np.array([s == DONE and v in ("ok", None) for s, v in zip(status, verdicts, strict=True)], bool)
    if good.all() or not good.any():
        return []
    what = "points that are ok" if any(verdicts) else "points that are done"
    return [share_drawing(axis, good, what, f"outcome-{k}") for k, axis in enumerate(axes)]


def trade_offs(metrics: Sequence[Metric], every: Sequence[Metric], words: Sequence[str]) -> list[Figure]:
    """Fronts of pairs of the first metrics, and of the first one with the time that it took."""
    chosen = list(metrics[:4])
    pairs = list(combinations(chosen, 2))
    patterns = ("time.run.total_s", "time.compare.*", "time.*")
    times = [each for pattern in patterns for each in every if fnmatchcase(each.column, pattern)]
    if chosen and times and times[0].column not in {each.column for each in chosen}:
        pairs.append((times[0], chosen[0]))
    drawn = [trade_off(first, second, words, f"front-{k}") for k, (first, second) in enumerate(pairs)]
    return [each for each in drawn if each is not None]


def consistency_figures(found: Sequence[Consistency]) -> list[Figure]:
    """NEES and coverage, each in a drawing."""
    by = {
        group: [each for each in found if each.group == group]
        for group in (NEES, COVERAGE, COVERAGE_CONSTANTS)
    }
    return [consistency_drawing(own, group, f"consistency-{group}") for group, own in by.items() if own]


def consistency_rows(found: Sequence[Consistency]) -> list[Row]:
    """The same as a table."""
    return [
        {
            "name": f"{'NEES' if each.group == NEES else 'coverage'}, {QUANTITIES.get(each.name, each.name)}",
            "runs": str(each.runs),
            "mean": f"{each.mean:.3g}",
            "band": "too few runs" if np.isnan(each.low) else f"{each.low:.3g} to {each.high:.3g}",
            "expected": f"{each.expected:.3g}",
            "expected_band": f"{each.expected_low:.3g} to {each.expected_high:.3g}",
            "inside": f"{each.inside:.0%}",
            "inside_band": f"{each.inside_low:.0%} to {each.inside_high:.0%}",
            "sigmas": each.sigmas,
        }
        for each in found
    ]


def reasons(table: pa.Table, status: str, column: str) -> list[Row]:
    """The texts of a column of the points with this status, the most frequent first.

    Texts that differ by their numbers alone are one; three points are named for each.
    """
    said = {
        number: text
        for number, own, text in zip(
            table.column("point").to_pylist(), texts(table, "status"), texts(table, column), strict=True
        )
        if own == status and (text or status == FAILED)
    }
    groups: defaultdict[str, list[int]] = defaultdict(list)
    for number, text in said.items():
        groups[without_numbers(str(text))].append(number)
    return [
        {
            "text": str(said[found[0]]),
            "count": len(found),
            "share": len(found) / table.num_rows,
            "points": ", ".join(map(str, found[:3])) + (", ..." if len(found) > 3 else ""),
            "is_varied": len({said[number] for number in found}) > 1,
        }
        for found in sorted(groups.values(), key=len, reverse=True)[:12]
    ]


def worst_runs(
    metrics: Sequence[Metric], table: pa.Table, words: Sequence[str], store: Store
) -> list[tuple[Metric, list[Row]]]:
    """The five points that are worst in each of the first metrics, with a link to a report that was kept."""
    found = []
    verdicts = texts(table, "verdict")
    for metric in metrics[:4]:
        known = np.flatnonzero(np.isfinite(metric.values))
        order = known[np.argsort(metric.values[known], kind="stable")]
        rows = []
        for row in (order if metric.more_is_better else order[::-1])[:5].tolist():
            report = store.run_folder(str(table.column("digest.point")[row])) / "run" / "report.html"
            rows.append(
                {
                    "number": table.column("point")[row].as_py(),
                    "value": f"{metric.values[row]:.4g}",
                    "settings": words[row].partition(": ")[2],
                    "verdict": verdicts[row] or "",
                    "link": report.relative_to(store.folder).as_posix() if report.is_file() else "",
                }
            )
        found.append((metric, rows))
    return found


def words_of_points(table: pa.Table, axes: Sequence[Axis], seeds: Sequence[str]) -> list[str]:
    """Number, settings and seeds (names of columns) of each point in a line."""
    drawn = {name: table.column(name).to_pylist() for name in seeds if name in table.column_names}
    words = []
    for row, number in enumerate(table.column("point").to_pylist()):
        values = [a.labels[round(a.values[row])] if a.labels else f"{a.values[row]:.4g}" for a in axes]
        settings = [f"{axis.name} {value}" for axis, value in zip(axes, values, strict=True)]
        settings += [f"{name} {values[row]}" for name, values in drawn.items()]
        words.append(f"point {number}: {', '.join(settings)}")
    return words


def share_rows(found: Sequence[VarianceShares], axes: Sequence[Axis]) -> list[tuple[str, list[Row]]]:
    """The table of variances: a row an axis, a cell a metric."""

    def percent(value: float, low: float, high: float) -> str:
        return f"{value:.0%} ({low:.0%} to {high:.0%})"

    rows = []
    for k, axis in enumerate(axes):
        cells = []
        for share in (each.shares[k] for each in found):
            cell: Row = {"text": "too few points", "width": 0, "total": ""}
            if not np.isnan(share.first):
                cell["text"] = percent(share.first, share.low, share.high)
                cell["width"] = round(100 * min(max(share.first, 0.0), 1.0))
            if share.total is not None:
                cell["total"] = f"in total {percent(share.total, share.total_low, share.total_high)}"
            cells.append(cell)
        rows.append((axis.name, cells))
    return rows


def quantile_rows(metrics: Sequence[Metric]) -> list[tuple[str, list[str]]]:
    """All metrics in numbers."""
    return [
        (
            each.title,
            [str(len(each.known)), *(f"{q:.4g}" for q in np.quantile(each.known, [0, 0.1, 0.5, 0.9, 1]))],
        )
        for each in metrics
    ]
