"""Findings on trust: what the runs of all studies together say of themselves, beside the truth."""

import numpy as np

from benchmarks.studies.confidence import median, share_text
from benchmarks.studies.study_results import ATTITUDE, RATE, Part, Results, rate_deg_s
from polhode.metrics import COMPONENTS, NEES, expected_range
from polhode.records import Bools
from polhode.studies.page.drawings import QUANTITIES

WRONG_RATE = 0.1
"""Error of the rate over the rate, above which an answer is wrong"""
WRONG_DEG = 5.0
"""Median error of the attitude, likewise"""
FAR_DEG = 0.5
"""Median error of the attitude that is far beyond the usual one"""
VERDICTS = ("ok", "degraded", "failed")
INTERVALS = ("k1", "k2")


def every_run(*studies: Results) -> list[Part]:
    """Are runs that are ok right, do intervals hold the truth, are standard deviations those of errors?"""
    return [_by_verdict(studies), _wrong(studies), _intervals(studies), _bands(studies)]


def _by_verdict(studies: tuple[Results, ...]) -> Part:
    """Errors of the runs of each verdict, study by study."""
    rows = []
    for each in studies:
        for word in VERDICTS:
            at = each.done & (each.verdict == word)
            if at.any():
                share = 100.0 * each.errors(RATE)[at] / rate_deg_s(each)[at]
                attitude = each.errors(ATTITUDE)[at]
                far = share_text(int((attitude > FAR_DEG).sum()), int(at.sum()))
                rows.append([each.title, word, median(share).text(), median(attitude).text(), far])
    columns = f"study | run | rate, of itself [%] | {ATTITUDE.title} | attitude off by {FAR_DEG:g} deg"
    return Part("Errors by the verdict of the run", columns, rows, right_from=2)


def _wrong(studies: tuple[Results, ...]) -> Part:
    """Runs of each verdict whose answer is wrong."""
    verdict = np.concatenate([each.verdict[each.done] for each in studies])
    wrong = np.concatenate([_is_wrong(each)[each.done] for each in studies])
    rows = [
        [word, share_text(int(wrong[verdict == word].sum()), int((verdict == word).sum()))]
        for word in VERDICTS
    ]
    title = f"Wrong answers: the rate by {WRONG_RATE:.0%}, or the attitude by {WRONG_DEG:g} deg in the median"
    return Part(title, "run | wrong", rows)


def _is_wrong(results: Results) -> Bools:
    wrong_rate = results.errors(RATE) > WRONG_RATE * rate_deg_s(results)
    return np.asarray(wrong_rate | (results.errors(ATTITUDE) > WRONG_DEG))


def _intervals(studies: tuple[Results, ...]) -> Part:
    """Intervals that are given for what a run calls undetermined."""
    rows, all_held = [], []
    for name in INTERVALS:
        columns = [each.column(f"evaluate.truth_in_interval.{name}") for each in studies]
        held = np.concatenate([each[np.isfinite(each)] for each in columns])
        all_held.append(held)
        rows.append([name, share_text(int(held.sum()), len(held))])
    both = np.concatenate(all_held)
    rows.append(["both", share_text(int(both.sum()), len(both))])
    title = "Intervals of what is not determined"
    return Part(title, "quantity | truth inside", rows)


def _bands(studies: tuple[Results, ...]) -> Part:
    """Normalised errors inside their own band of 95 %, above it (sigmas too small), below it (too large)."""
    rows = []
    for name in COMPONENTS:
        columns = [each.column(f"evaluate.{NEES}.{name}") for each in studies]
        values = np.concatenate([each[np.isfinite(each)] for each in columns])
        band = expected_range(NEES, name)
        if band is not None and len(values):
            above, below = int((values > band[1]).sum()), int((values < band[0]).sum())
            inside = share_text(len(values) - above - below, len(values))
            rows.append([QUANTITIES.get(name, name), inside, above, below])
    columns_of = "standard deviation of | runs inside | above: too small | below: too large"
    return Part("Runs in their own band of 95 %", columns_of, rows)
