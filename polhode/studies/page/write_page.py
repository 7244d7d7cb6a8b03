"""study.html is filled and written: by ``polhode sweep`` at its end, and again by ``--page-only``."""

from collections import Counter
from pathlib import Path

import pyarrow as pa

from polhode.files.atomic import write_text
from polhode.report.template import fill
from polhode.runtime.errors import InputError, printable
from polhode.studies.page import sections
from polhode.studies.page.columns import Metric, axes_of, choose_metrics, is_seed, metrics_of, texts
from polhode.studies.page.consistency import consistencies
from polhode.studies.page.variance_shares import has_salib, variance_shares
from polhode.studies.steps import DONE, FAILED
from polhode.studies.store import Store
from polhode.studies.study import OpenStudy
from polhode.studies.table import PAGE, read_table

MAX_ROWS = 50_000
MIN_METRICS, MAX_METRICS = 4, 12


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
    # of all metrics together: of more axes, fewer metrics are drawn
    most = min(max(80 // (1 + len(axes)), MIN_METRICS), MAX_METRICS)
    metrics = choose_metrics(every, study.settings.metrics, most)
    repeated = [name for name in study.columns if is_seed(name)]
    words = sections.words_of_points(table, axes, repeated)
    shared = [variance_shares(study, axes, metric) for metric in metrics[:6]] if axes else []
    agreement = consistencies(table)
    return fill(
        "study.html.j2",
        title=printable(study.settings.title or folder.resolve().name),
        finding=_finding(study, table),
        facts=_facts(study, table),
        repeated=repeated,
        outcomes=sections.outcome_figures(table, axes),
        shared=shared,
        share_rows=sections.share_rows(shared, axes),
        sobol=_sobol_words(study, [each.metric for each in shared if each.is_sobol]),
        logarithms=any(each.metric.is_logarithmic for each in shared),
        parts=sections.metric_parts(metrics, axes),
        fronts=sections.trade_offs(metrics, every, words),
        consistency=sections.consistency_figures(agreement),
        consistency_rows=sections.consistency_rows(agreement),
        failed=sections.reasons(table, FAILED, "reason"),
        doubtful=sections.reasons(table, DONE, "doubts"),
        worst=sections.worst_runs(metrics, table, words, store),
        quantiles=sections.quantile_rows(every),
    )


def _finding(study: OpenStudy, table: pa.Table) -> str:
    """The result in a sentence."""
    failed = texts(table, "status").count(FAILED)
    verdicts = Counter(each for each in texts(table, "verdict") if each)
    parts = [f"{verdicts[word]} {word}" for word in ("ok", "degraded", "failed") if verdicts[word]]
    stored = _points(study.count)
    if table.num_rows < study.count:
        stored = f"{table.num_rows:,} of {stored}"
    counts = ", ".join([*parts, f"{_points(failed)} without a result"] if failed else parts)
    return f"{stored}: {counts}." if counts else f"{stored}, all with a result."


def _points(count: int) -> str:
    return f"{count:,} point{'' if count == 1 else 's'}"


def _facts(study: OpenStudy, table: pa.Table) -> list[str]:
    """What stands above the title: what was done, with what, when."""
    done = ", ".join(study.settings.steps) or "the settings alone"
    versions = sorted({each for each in texts(table, "version.polhode") if each})
    processors = sorted({each for each in texts(table, "version.processor") if each})
    finished = max((each for each in texts(table, "time.finished") if each), default="")
    return [
        *(f"{', '.join(factor.columns)}: {len(factor)} values" for factor in study.factors),
        f"each point: {done}",
        *(f"polhode {each}" for each in versions),
        *processors,
        *([f"{finished[:16].replace('T', ' ')} UTC"] if finished else []),
    ]


def _sobol_words(study: OpenStudy, by_salib: list[Metric]) -> str:
    """How the variances were shared."""
    if by_salib:
        return (
            "Sobol indices by SALib: the first number is the axis by itself, the second with all that it "
            "takes part in. In brackets 95 % bands."
        )
    design = study.settings.design
    if design is not None and design.method == "saltelli" and not has_salib():
        note = "SALib, which would give Sobol indices of this design, is not installed (polhode doctor)."
    elif design is not None and design.method == "saltelli":
        note = "No Sobol indices: too few draws have all their points, or axes vary beside the design."
    else:
        note = "Total indices need a design of the method saltelli."
    return (
        "First order only: the variance between the groups of an axis over that of all points, less what "
        "chance alone would give. In brackets 95 % bands by the bootstrap. What is missing to 100 % is the "
        f"seed's, or of axes that act together. {note}"
    )
