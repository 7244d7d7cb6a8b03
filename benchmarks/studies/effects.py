"""Tables of findings that every study can have: outcomes, levels of its settings and ratios between them."""

from collections.abc import Iterable, Sequence

import numpy as np

from benchmarks.studies.confidence import (
    Interval,
    finite,
    geometric_mean,
    median,
    powers,
    share_text,
    significant,
)
from benchmarks.studies.study_results import (
    Error,
    Part,
    Results,
    by_level,
    level_names,
)
from polhode.lie import Array
from polhode.metrics import NEES
from polhode.records import Bools
from polhode.studies.page.columns import Axis, metric_of
from polhode.studies.page.consistency import consistencies
from polhode.studies.page.drawings import QUANTITIES
from polhode.studies.page.sections import reasons
from polhode.studies.page.variance_shares import variance_shares

MAX_REASON = 150
"""Characters of a reason in a table"""


def outcomes(results: Results) -> Part:
    """How many runs are ok, and what the others say."""
    count = results.table.num_rows
    rows = [
        f"{word} | {share_text(int((results.verdict == word).sum()), count)}"
        for word in ("ok", "degraded", "failed")
    ]
    rows.append(f"without an answer | {share_text(int((~results.done).sum()), count)}")
    return Part("Outcomes", "points | share, with its interval of 95 %", rows)


def doubts(results: Results) -> Part:
    """Why runs failed or are doubtful, numbers aside."""
    failed, doubtful = reasons(results.table)
    rows = [
        [kind, each.count, each.points, _short(each.text)]
        for kind, found in (("failed", failed), ("doubted", doubtful))
        for each in found
    ]
    return Part("Reasons", "points that | count | for example | reason", rows, right_from=4)


def _short(text: str) -> str:
    return text if len(text) <= MAX_REASON else f"{text[:MAX_REASON].rsplit(' ', 1)[0]} ..."


def levels(results: Results, errors: Sequence[Error], among: Bools | None = None) -> list[Part]:
    """For each setting that was varied: runs that are ok, and medians at each of its levels."""
    use = results.done if among is None else among
    parts = []
    for axis in results.axes:
        rows = []
        for level, at in by_level(results, axis.name).items():
            cells = [share_text(int((at & results.ok).sum()), int(at.sum()))]
            cells += [median(results.errors(error)[at & use]).text() for error in errors]
            rows.append([level, *cells])
        titles = " | ".join(error.title for error in errors)
        parts.append(Part(f"Medians along {axis.name}", f"{axis.name} | ok | {titles}", rows))
    return parts


def ratios(results: Results, errors: Sequence[Error]) -> list[Part]:
    """For each setting: errors over those at its first level, all other settings and the seed being equal."""
    parts = []
    for axis in results.axes:
        names = level_names(results, axis.name)
        first = names[0]
        others = results.settings.drop(columns=axis.name).astype(str).agg(tuple, axis=1).tolist()
        base = {other: k for k, (name, other) in enumerate(zip(names, others, strict=True)) if name == first}
        rows = []
        for level in dict.fromkeys(names):
            own = [
                (k, base[others[k]]) for k, name in enumerate(names) if name == level and others[k] in base
            ]
            if level == first or not own:
                continue
            pairs = np.array(own)
            found = [_ratios(results.errors(error), pairs) for error in errors]
            most = max(each.count for each in found)
            rows.append([level, most, *(each.text(3) for each in found)])
        if rows:
            titles = " | ".join(error.title for error in errors)
            title = f"Errors over those at {axis.name} {first}, all else being equal"
            parts.append(Part(title, f"{axis.name} | runs compared | {titles}", rows))
    return parts


def _ratios(values: Array, pairs: "np.ndarray[tuple[int, int], np.dtype[np.int64]]") -> Interval:
    with np.errstate(divide="ignore", invalid="ignore"):
        found = values[pairs[:, 0]] / values[pairs[:, 1]]
    return geometric_mean(found[found > 0.0])


def exponents(
    title: str,
    errors: Iterable[tuple[Error, Array]],
    by: dict[str, Array],
    groups: Sequence[object] = (),
) -> Part:
    """How errors (n,) grow with each quantity (n,), as a product of powers."""
    rows = []
    for error, values in errors:
        found = powers(values, by, groups)
        if found is not None:
            cells = [each.fixed() for each in found.exponents.values()]
            count = next(iter(found.exponents.values())).count
            rows.append([error.title, count, *cells, f"{found.explained:.0%}"])
    return Part(title, f"error | runs | {' | '.join(by)} | variance explained", rows)


def numeric_axes(results: Results) -> dict[str, Array]:
    """Settings that are numbers above 0 and no labels, by which errors may grow as powers."""
    return {
        axis.name: axis.values for axis in results.axes if not axis.labels and bool((axis.values > 0.0).all())
    }


def variances(results: Results, axes: Sequence[Axis], errors: Sequence[Error]) -> Part:
    """How much of the variance of each error the groups of an axis explain by themselves."""
    rows = []
    for error in errors:
        found = variance_shares(results.study, axes, metric_of(results.table, error.column))
        shares = [Interval(0, each.first, each.low, each.high).percent() for each in found.shares]
        rows.append([error.title, *shares])
    return Part("Share of the variance", f"error | {' | '.join(axis.name for axis in axes)}", rows)


def sigmas(results: Results) -> Part:
    """Whether errors agree with the standard deviations of the runs: normalised errors squared (NEES)."""
    rows = []
    for each in consistencies(results.table):
        if each.group == NEES:
            mean = Interval(each.runs, *(v / each.expected for v in (each.mean, each.low, each.high)))
            expected = f"{each.expected_low / each.expected:.2f} to {each.expected_high / each.expected:.2f}"
            inside = share_text(round(each.inside * each.runs), each.runs)
            name = QUANTITIES.get(each.name, each.name)
            rows.append([name, each.runs, mean.fixed(), expected, each.sigmas, inside])
    columns = (
        "standard deviation of | runs | mean NEES over its expectation | 95 of 100 studies | is | "
        "runs in their own band of 95 %"
    )
    return Part("Standard deviations", columns, rows)


def determined(results: Results) -> Part:
    """Errors where a run says that it has determined a quantity, and where not; whether intervals hold."""
    rows = []
    for name, column in (("k1", "error_k1"), ("k2", "error_k2"), ("axes", "principal_axes_error_deg")):
        said = results.column(f"run.identifiable.{name}")
        error = np.abs(results.column(f"evaluate.{column}"))
        cells: list[object] = [f"{name} [deg]" if name == "axes" else name]
        for chosen in (said == 1.0, said == 0.0):
            known = finite(error[chosen])
            largest = significant(float(known.max())) if len(known) else "-"
            cells += [len(known), median(known).text(), largest]
        held = finite(results.column(f"evaluate.truth_in_interval.{name}"))
        cells.append(share_text(int(held.sum()), len(held)) if len(held) else "-")
        rows.append(cells)
    columns = (
        "quantity | determined | median error | largest | not determined | median error | largest | "
        "truth in the interval that is given instead"
    )
    return Part("What a run says that it has determined", columns, rows)
