"""The parts of the page: what each of them shows of a study."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import combinations

import numpy as np
import pyarrow as pa

from polhode.geometry.lie import Bools
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
from polhode.studies.page.variance_shares import VarianceShare, VarianceShares
from polhode.studies.steps import DONE, FAILED
from polhode.studies.store import Store

WORST = 5
EXAMPLES = 3
"""Points that are named for a reason"""


@dataclass(frozen=True)
class MetricPart:
    """One metric with its drawings."""

    key: str
    metric: Metric
    figures: list[Figure]
    is_open: bool


@dataclass(frozen=True)
class Reason:
    """Points that failed, or are doubtful, for one reason."""

    text: str
    """That of the first of them"""
    count: int
    share: float
    points: str
    """Numbers of some of them"""
    is_varied: bool
    """Whether the numbers in the reason differ between points"""


@dataclass(frozen=True)
class WorstRun:
    """A point that is bad in a metric."""

    number: int
    value: str
    settings: str
    verdict: str
    link: str
    """Of its report, relative to the page; empty: it was not kept"""


def metric_parts(metrics: Sequence[Metric], axes: Sequence[Axis]) -> list[MetricPart]:
    """Distribution and dependence on every axis of each metric."""
    return [
        MetricPart(
            f"metric-{number}",
            metric,
            [
                distribution(metric, f"metric-{number}-values"),
                *(dependence(metric, axis, f"metric-{number}-{k}") for k, axis in enumerate(axes)),
            ],
            number < 3,
        )
        for number, metric in enumerate(metrics)
    ]


def outcome_figures(table: pa.Table, axes: Sequence[Axis]) -> list[Figure]:
    """The share of points with a good answer along each axis; empty: all are good, or none is."""
    good = is_good(table)
    if good.all() or not good.any():
        return []
    what = "points that are ok" if any(texts(table, "verdict")) else "points that are done"
    return [share_drawing(axis, good, what, f"outcome-{k}") for k, axis in enumerate(axes)]


def is_good(table: pa.Table) -> Bools:
    """(n,) Whether a point is done, and its run ok where it has one."""
    verdicts, status = texts(table, "verdict"), texts(table, "status")
    return np.array(
        [s == DONE and v in ("ok", None) for s, v in zip(status, verdicts, strict=True)], dtype=bool
    )


def trade_offs(metrics: Sequence[Metric], every: Sequence[Metric], words: Sequence[str]) -> list[Figure]:
    """Fronts of pairs of the first metrics, and of the first one with the time that it took."""
    chosen = list(metrics[:4])
    pairs = list(combinations(chosen, 2))
    times = [
        each
        for pattern in ("time.run.total_s", "time.compare.*", "time.*")
        for each in every
        if fnmatchcase(each.column, pattern)
    ]
    if chosen and times and times[0].column not in {each.column for each in chosen}:
        pairs.append((times[0], chosen[0]))
    drawn = [trade_off(first, second, words, f"front-{k}") for k, (first, second) in enumerate(pairs)]
    return [each for each in drawn if each is not None]


def consistency_figures(found: Sequence[Consistency]) -> list[Figure]:
    """NEES and coverage, each in a drawing."""
    groups = (NEES, COVERAGE, COVERAGE_CONSTANTS)
    by = {group: [each for each in found if each.group == group] for group in groups}
    return [consistency_drawing(own, group, f"consistency-{group}") for group, own in by.items() if own]


def consistency_rows(found: Sequence[Consistency]) -> list[dict[str, str]]:
    """The same as a table."""
    return [
        {
            "name": f"{_GROUPS[each.group]}, {QUANTITIES.get(each.name, each.name)}",
            "runs": str(each.runs),
            "mean": f"{each.mean:.3g}",
            "band": _band(each.low, each.high),
            "expected": f"{each.expected:.3g}",
            "expected_band": _band(each.expected_low, each.expected_high),
            "inside": f"{each.inside:.0%}",
            "inside_band": f"{each.inside_low:.0%} to {each.inside_high:.0%}",
            "sigmas": each.sigmas,
        }
        for each in found
    ]


_GROUPS = {NEES: "NEES", COVERAGE: "coverage", COVERAGE_CONSTANTS: "coverage"}


def _band(low: float, high: float) -> str:
    return "too few runs" if np.isnan(low) else f"{low:.3g} to {high:.3g}"


def reasons(table: pa.Table) -> tuple[list[Reason], list[Reason]]:
    """Why points failed, and why runs are doubtful: the most frequent first."""
    status, numbers = texts(table, "status"), table.column("point").to_pylist()
    failed = {
        number: str(reason)
        for number, each, reason in zip(numbers, status, texts(table, "reason"), strict=True)
        if each == FAILED
    }
    doubtful = {
        number: doubt
        for number, each, doubt in zip(numbers, status, texts(table, "doubts"), strict=True)
        if each == DONE and doubt
    }
    return _grouped(failed, table.num_rows), _grouped(doubtful, table.num_rows)


def _grouped(said: dict[int, str], of: int) -> list[Reason]:
    groups: defaultdict[str, list[int]] = defaultdict(list)
    for number, text in said.items():
        groups[without_numbers(text)].append(number)
    ordered = sorted(groups.values(), key=len, reverse=True)
    return [
        Reason(
            said[found[0]],
            len(found),
            len(found) / of,
            ", ".join(map(str, found[:EXAMPLES])) + (", ..." if len(found) > EXAMPLES else ""),
            len({said[number] for number in found}) > 1,
        )
        for found in ordered[:12]
    ]


def worst_runs(
    metrics: Sequence[Metric], table: pa.Table, words: Sequence[str], store: Store
) -> list[tuple[Metric, list[WorstRun]]]:
    """The points that are worst in each of the first metrics."""
    found = []
    for metric in metrics[:4]:
        known = np.flatnonzero(np.isfinite(metric.values))
        order = known[np.argsort(metric.values[known], kind="stable")]
        worst = order[:WORST] if metric.more_is_better else order[::-1][:WORST]
        found.append((metric, [_worst_run(metric, int(row), table, words, store) for row in worst]))
    return found


def _worst_run(metric: Metric, row: int, table: pa.Table, words: Sequence[str], store: Store) -> WorstRun:
    address = str(table.column("digest.point")[row].as_py())
    report = store.run_folder(address) / "run" / "report.html"
    link = report.relative_to(store.folder).as_posix() if report.is_file() else ""
    number = int(table.column("point")[row].as_py())
    said = words[row].partition(": ")[2]
    verdict = texts(table.slice(row, 1), "verdict")[0] or ""
    return WorstRun(number, f"{metric.values[row]:.4g}", said, verdict, link)


def words_of_points(table: pa.Table, axes: Sequence[Axis], seeds: Sequence[str] = ()) -> list[str]:
    """Number, settings and seeds (names of columns) of each point in a line."""
    drawn = {name: table.column(name).to_pylist() for name in seeds if name in table.column_names}
    words = []
    for row, number in enumerate(table.column("point").to_pylist()):
        settings = [f"{axis.name} {_setting(axis, axis.values[row])}" for axis in axes]
        settings += [f"{name} {values[row]}" for name, values in drawn.items()]
        words.append(f"point {number}: {', '.join(settings)}")
    return words


def _setting(axis: Axis, value: float) -> str:
    return axis.labels[round(value)] if axis.labels else f"{value:.4g}"


def share_rows(
    found: Sequence[VarianceShares], axes: Sequence[Axis]
) -> list[tuple[str, list[dict[str, object]]]]:
    """The table of variances: a row an axis, a cell a metric."""
    rows = []
    for k, axis in enumerate(axes):
        rows.append((axis.name, [_share_cell(each.shares[k]) for each in found]))
    return rows


def _share_cell(share: VarianceShare) -> dict[str, object]:
    if np.isnan(share.first):
        return {"text": "too few points", "width": 0, "total": ""}
    total = (
        "" if share.total is None else f"in total {_percent(share.total, share.total_low, share.total_high)}"
    )
    return {
        "text": _percent(share.first, share.low, share.high),
        "width": round(100 * min(max(share.first, 0.0), 1.0)),
        "total": total,
    }


def _percent(value: float, low: float, high: float) -> str:
    return f"{value:.0%} ({low:.0%} to {high:.0%})"


def quantile_rows(metrics: Sequence[Metric]) -> list[tuple[str, list[str]]]:
    """All metrics in numbers."""
    rows = []
    for metric in metrics:
        known = metric.known
        cells = [f"{each:.4g}" for each in np.quantile(known, [0.0, 0.1, 0.5, 0.9, 1.0])]
        rows.append((metric.title, [str(len(known)), *cells]))
    return rows


def finished_at(table: pa.Table) -> str:
    """When the last point was finished (UTC), as day and minute; empty: unknown."""
    known = [each for each in texts(table, "time.finished") if each]
    return max(known)[:16].replace("T", " ") if known else ""
