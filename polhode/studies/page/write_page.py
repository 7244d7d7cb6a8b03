"""study.html is filled and written: by ``polhode sweep`` at its end, and again by ``--page-only``.

Whether errors agree with the standard deviations that the runs state: a normalised squared error (NEES) of n
components is n on average, and three standard deviations hold 99.7 % of the components. The frames of a run
depend on one another, so that a run counts once: the expected band of the mean over N runs is that of a
chi-squared distribution of N n degrees of freedom over N.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from scipy import stats

from polhode.files.atomic import write_text
from polhode.records.metrics import COMPONENTS, COVERAGE, COVERAGE_CONSTANTS, NEES, expected_range
from polhode.report.template import fill
from polhode.runtime.errors import InputError, printable
from polhode.studies.page.columns import (
    Axis,
    Metric,
    axes_of,
    choose_metrics,
    is_seed,
    metrics_of,
    numbers,
    texts,
    without_numbers,
)
from polhode.studies.page.dependence import CONFIDENCE, bootstrap_band, share_band, variance_share
from polhode.studies.page.drawings import dependence, share_drawing
from polhode.studies.steps import DONE, FAILED
from polhode.studies.store import Store
from polhode.studies.study import OpenStudy
from polhode.studies.table import PAGE, read_table

MAX_ROWS = 50_000
QUANTITIES = {"com": "centre of mass", "axes": "principal axes", "angular_velocity": "angular velocity"}
"""Names of quantities with a NEES, where the key is no word"""
Row = dict[str, Any]
"""Of a table of the page: what the template names"""


def write_page(study: OpenStudy, folder: Path) -> None:
    """Write DIR/study.html of the rows that there are, at most ``MAX_ROWS``, chosen at random.

    Raises InputError: the folder is that of no study, or no row is there; RunFailure.
    """
    table = read_table(folder, MAX_ROWS)
    if not table.num_rows:
        raise InputError(f"{folder}: no point of this study is stored yet; run the sweep without --page-only")
    write_text(folder / PAGE, render(study, table, folder))


def render(study: OpenStudy, table: pa.Table, folder: Path) -> str:
    """The whole page."""
    store, axes, every = Store(folder), axes_of(study, table), metrics_of(table)
    # at most 80 drawings in all: of more axes, fewer metrics are drawn
    metrics = choose_metrics(every, study.settings.metrics, min(max(80 // max(len(axes), 1), 4), 12))
    repeated = [name for name in study.columns if is_seed(name)]
    verdicts, status = texts(table, "verdict"), texts(table, "status")
    good = np.array([s == DONE and v in ("ok", None) for s, v in zip(status, verdicts, strict=True)], bool)
    what = "points that are ok" if any(verdicts) else "points that are done"
    drawn = [] if good.all() or not good.any() else axes
    return fill(
        "study.html.j2",
        title=printable(study.settings.title or folder.resolve().name),
        finding=_finding(study, table),
        facts=_facts(study, table),
        repeated=repeated,
        outcomes=[share_drawing(axis, good, what, f"outcome-{k}") for k, axis in enumerate(drawn)],
        shared=metrics[:6] if axes else [],
        share_rows=_share_rows(metrics[:6], axes),
        parts=[
            {
                "key": f"metric-{number}",
                "metric": metric,
                "figures": [dependence(metric, axis, f"metric-{number}-{k}") for k, axis in enumerate(axes)],
                "is_open": number < 3,
            }
            for number, metric in enumerate(metrics if axes else [])
        ],
        consistency=consistencies(table),
        failed=_reasons(table, FAILED, "reason"),
        doubtful=_reasons(table, DONE, "doubts"),
        worst=_worst_points(metrics[:4], table, _settings_in_words(table, axes, repeated), store),
        quantiles=[
            (
                each.title,
                [str(len(each.known)), *(f"{q:.4g}" for q in np.quantile(each.known, [0, 0.1, 0.5, 0.9, 1]))],
            )
            for each in every
        ],
    )


def _finding(study: OpenStudy, table: pa.Table) -> str:
    """The result in a sentence."""

    def points(count: int) -> str:
        return f"{count:,} point{'' if count == 1 else 's'}"

    failed = texts(table, "status").count(FAILED)
    verdicts = Counter(each for each in texts(table, "verdict") if each)
    parts = [f"{verdicts[word]} {word}" for word in ("ok", "degraded", "failed") if verdicts[word]]
    stored = points(study.count)
    if table.num_rows < study.count:
        stored = f"{table.num_rows:,} of {stored}"
    counts = ", ".join([*parts, f"{points(failed)} without a result"] if failed else parts)
    return f"{stored}: {counts}." if counts else f"{stored}, all with a result."


def _facts(study: OpenStudy, table: pa.Table) -> list[str]:
    """What stands above the title: what was done, with what, when."""
    versions = sorted({each for each in texts(table, "version.polhode") if each})
    processors = sorted({each for each in texts(table, "version.processor") if each})
    finished = max((each for each in texts(table, "time.finished") if each), default="")
    return [
        *(f"{', '.join(factor.columns)}: {len(factor)} values" for factor in study.factors),
        f"each point: {', '.join(study.settings.steps) or 'the settings alone'}",
        *(f"polhode {each}" for each in versions),
        *processors,
        *([f"{finished[:16].replace('T', ' ')} UTC"] if finished else []),
    ]


def consistencies(table: pa.Table) -> list[Row]:
    """Whether the errors of all runs agree with their standard deviations: a row for each quantity that was
    evaluated, with the mean and its bootstrap band beside where the mean lies in 95 of 100 studies if the
    standard deviations are right, and the share of the runs inside the band of a single run."""
    found: list[Row] = []
    tail, within = 0.5 * (1.0 - CONFIDENCE), float(stats.chi2.cdf(9.0, 1))
    for group in (NEES, COVERAGE, COVERAGE_CONSTANTS):
        for name, components in COMPONENTS.items():
            values = numbers(table, f"evaluate.{group}.{name}")
            values = values[np.isfinite(values)]
            runs, band = len(values), expected_range(group, name)
            if runs < 3 or band is None:
                continue
            if group == NEES:
                expected = float(components)
                least, most = (stats.chi2.ppf([tail, 1.0 - tail], runs * components) / runs).tolist()
            else:
                # as if each run had one frame, of so many components
                expected, half = within, 1.96 * float(np.sqrt(within * (1.0 - within) / (runs * components)))
                least, most = within - half, min(within + half, 1.0)
            low, high = bootstrap_band(values, np.mean)
            above, sigmas = low > most, "right"
            if above or high < least:
                sigmas = "too small" if above == (group == NEES) else "too large"
            inside = (values >= band[0]) & (values <= band[1])
            share_low, share_high = share_band(int(inside.sum()), runs)
            found.append(
                {
                    "name": f"{'NEES' if group == NEES else 'coverage'}, {QUANTITIES.get(name, name)}",
                    "runs": str(runs),
                    "mean": f"{values.mean():.3g}",
                    "band": "too few runs" if np.isnan(low) else f"{low:.3g} to {high:.3g}",
                    "expected": f"{expected:.3g}",
                    "expected_band": f"{least:.3g} to {most:.3g}",
                    "inside": f"{inside.mean():.0%}",
                    "inside_band": f"{share_low:.0%} to {share_high:.0%}",
                    "sigmas": sigmas,
                }
            )
    return found


def _reasons(table: pa.Table, status: str, column: str) -> list[Row]:
    """The texts of a column of the points with this status, the most frequent first.

    Texts that differ by their numbers alone are one; three points are named for each.
    """
    numbers_of_points = table.column("point").to_pylist()
    said = {
        number: text
        for number, own, text in zip(
            numbers_of_points, texts(table, "status"), texts(table, column), strict=True
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


def _worst_points(
    metrics: Sequence[Metric], table: pa.Table, settings: Sequence[str], store: Store
) -> list[tuple[Metric, list[Row]]]:
    """The five points that are worst in each metric, with a link to a report that was kept."""
    found = []
    verdicts = texts(table, "verdict")
    for metric in metrics:
        known = np.flatnonzero(np.isfinite(metric.values))
        order = known[np.argsort(metric.values[known], kind="stable")]
        rows = []
        for row in (order if metric.more_is_better else order[::-1])[:5].tolist():
            report = store.run_folder(str(table.column("digest.point")[row])) / "run" / "report.html"
            rows.append(
                {
                    "number": table.column("point")[row].as_py(),
                    "value": f"{metric.values[row]:.4g}",
                    "settings": settings[row],
                    "verdict": verdicts[row] or "",
                    "link": report.relative_to(store.folder).as_posix() if report.is_file() else "",
                }
            )
        found.append((metric, rows))
    return found


def _settings_in_words(table: pa.Table, axes: Sequence[Axis], seeds: Sequence[str]) -> list[str]:
    """Settings and seeds (names of columns) of each point in a line."""
    drawn = {name: table.column(name).to_pylist() for name in seeds if name in table.column_names}
    words = []
    for row in range(table.num_rows):
        values = [a.labels[round(a.values[row])] if a.labels else f"{a.values[row]:.4g}" for a in axes]
        settings = [f"{axis.name} {value}" for axis, value in zip(axes, values, strict=True)]
        words.append(", ".join(settings + [f"{name} {each[row]}" for name, each in drawn.items()]))
    return words


def _share_rows(metrics: Sequence[Metric], axes: Sequence[Axis]) -> list[tuple[str, list[Row]]]:
    """The table of variances: a row an axis, a cell a metric."""
    rows = []
    for axis in axes:
        cells = []
        for metric in metrics:
            share, low, high = variance_share(axis, metric)
            known = not np.isnan(share)
            text = f"{share:.0%} ({low:.0%} to {high:.0%})" if known else "too few points"
            cells.append({"text": text, "width": round(100 * share) if known else 0})
        rows.append((axis.name, cells))
    return rows
