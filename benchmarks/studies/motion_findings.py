"""Findings on motion: how far the target should turn between pairs, and how long one must look."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pandas as pd

from benchmarks.studies.confidence import geometric_mean, median, powers, share_text, significant
from benchmarks.studies.effects import determined, doubts, exponents, outcomes, sigmas, variances
from benchmarks.studies.study_results import (
    ATTITUDE,
    AXES,
    COM,
    COMPLETION,
    K1,
    K2,
    POSITION,
    RATE,
    SURFACE,
    Part,
    Results,
    prediction,
    rate_deg_s,
)
from polhode.lie import Array
from polhode.records import Bools
from polhode.studies.page.columns import Axis, axes_of

TURNS_DEG = (0.0, 9.0, 18.0, 36.0, 72.0, 180.0, 360.0)
"""Ends of the groups of turns between two pairs"""
CLEAR_DEG = 100.0
"""Below it every point of the study of frame rates has an answer"""
HORIZON_S = 10
PREDICTION = prediction(HORIZON_S)
BODY = "body"


def interval_s(results: Results) -> Array:
    """(n,) between two pairs."""
    return np.array([each.scene.interval_s if each.scene else np.nan for each in results.configurations])


def pairs_of(results: Results) -> Array:
    """(n,) stereo pairs."""
    return np.array([float(each.scene.frames) if each.scene else np.nan for each in results.configurations])


def revolutions(results: Results) -> Array:
    """(n,) that the target turned from the first pair to the last."""
    return np.asarray(rate_deg_s(results) * interval_s(results) * (pairs_of(results) - 1.0) / 360.0)


def bodies(results: Results) -> Part:
    """The bodies of the study, which the seed draws, by their true ratios of moments."""
    rows = []
    for seed, at in _by_body(results).items():
        true = [
            results.column(f"run.inertia.{k}") - results.column(f"evaluate.error_{k}") for k in ("k1", "k2")
        ]
        rows.append([seed, *(significant(float(np.nanmedian(each[at])), 3) for each in true)])
    return Part("Bodies, which the seed draws", "body | k1 | k2", rows)


def _by_body(results: Results) -> dict[object, Bools]:
    seeds = results.settings["seed"]
    return {seed: (seeds == seed).to_numpy() for seed in sorted(seeds.unique())}


def frame_rate_against_spin(results: Results) -> list[Part]:
    """Up to what turn between two pairs do runs hold, and what does it give?"""
    turn = rate_deg_s(results) * interval_s(results)
    clear = results.ok & (turn < CLEAR_DEG)
    long = clear & (interval_s(results) * (pairs_of(results) - 1.0) >= HORIZON_S)
    return [
        bodies(results),
        outcomes(results),
        _by_turn(results, turn),
        _growth_with_turn(results, turn, clear, long),
        _far_turns(results, turn),
        determined(results),
        sigmas(results),
        doubts(results),
    ]


def _by_turn(results: Results, turn: Array) -> Part:
    """Runs and their errors by the turn between two pairs."""
    looked = revolutions(results)
    rows = []
    for low, high in pairwise(TURNS_DEG):
        at = (turn > low) & (turn <= high)
        with_answer = at & results.done
        rows.append(
            [
                f"{low:g} to {high:g}",
                share_text(int((at & results.ok).sum()), int(at.sum())),
                f"{looked[at].min():.1f} to {looked[at].max():.1f}" if at.any() else "-",
                *(median(results.errors(e)[with_answer]).text() for e in (PREDICTION, RATE, ATTITUDE)),
            ]
        )
    columns = "turn between pairs [deg] | ok | revolutions seen | "
    columns += " | ".join(error.title for error in (PREDICTION, RATE, ATTITUDE))
    return Part("By the turn between two pairs", columns, rows)


def _growth_with_turn(results: Results, turn: Array, clear: Bools, long: Bools) -> Part:
    """Exponents of the turn, of all runs and of those that looked at least as long as they predict."""
    rows = []
    for name, at in (("all", clear), (f"looked for {HORIZON_S} s or longer", long)):
        for body, own in {"both": np.ones(len(turn), bool), **_by_body(results)}.items():
            cells = []
            for error in (PREDICTION, RATE):
                found = powers(results.errors(error)[at & own], {"turn": turn[at & own]})
                cells.append("-" if found is None else found.exponents["turn"].fixed())
            rows.append([name, body, int((at & own).sum()), *cells])
    title = f"Exponent of the turn between pairs, of runs that are ok with less than {CLEAR_DEG:g} deg"
    return Part(title, f"runs | body | count | {PREDICTION.title} | {RATE.title}", rows, right_from=2)


def _far_turns(results: Results, turn: Array) -> Part:
    """Every point with a far turn."""
    rows = []
    for k in np.flatnonzero(turn > CLEAR_DEG):
        cells = [significant(float(results.errors(e)[k])) for e in (RATE, PREDICTION)]
        verdict = results.verdict[k] if results.done[k] else "no answer"
        rows.append(
            [f"{turn[k]:.0f}", results.settings["seed"].iloc[k], interval_s(results)[k], verdict, *cells]
        )
    columns = f"turn between pairs [deg] | body | interval [s] | run | {RATE.title} | {PREDICTION.title}"
    return Part(f"Points that turn by more than {CLEAR_DEG:g} deg between pairs", columns, rows, right_from=4)


ERRORS = (PREDICTION, RATE, ATTITUDE, K1, K2, AXES, COM, POSITION, SURFACE, COMPLETION)


def revolutions_and_inertia(results: Results) -> list[Part]:
    """How long must one look until motion and inertia are known?"""
    looked = revolutions(results)
    return [
        bodies(results),
        outcomes(results),
        _by_pairs(results, looked),
        _steps_of_revolutions(results, looked),
        _growth_with_revolutions(results, looked, "motion", results.settings["motion"]),
        _growth_with_revolutions(results, looked, BODY, results.settings["seed"]),
        variances(results, _axes_with_body(results), ERRORS),
        _bodies_at_the_ends(results, looked),
        determined(results),
        _degraded(results, looked),
        sigmas(results),
        doubts(results),
    ]


def _by_pairs(results: Results, looked: Array) -> Part:
    """Medians by how long the target was seen."""
    pairs, errors = pairs_of(results), (PREDICTION, RATE, K1, K2, AXES, COM)
    rows = []
    for count in np.unique(pairs):
        at = pairs == count
        cells = [median(results.errors(error)[at]).text() for error in errors]
        rows.append([f"{looked[at].mean():.1f}", f"{count:.0f}", int(at.sum()), *cells])
    columns = f"revolutions seen | pairs | runs | {' | '.join(error.title for error in errors)}"
    return Part("By the revolutions that were seen", columns, rows, right_from=0)


def _steps_of_revolutions(results: Results, looked: Array) -> Part:
    """Errors over those of the next shorter look, of the same motion and body."""
    pairs, errors = pairs_of(results), (PREDICTION, RATE, K1, K2, AXES, COM)
    cases = list(zip(results.settings["motion"], results.settings["seed"], strict=True))
    rows = []
    for shorter, longer in pairwise(np.unique(pairs)):
        before = {cases[k]: k for k in np.flatnonzero(pairs == shorter)}
        steps = [(k, before[cases[k]]) for k in np.flatnonzero(pairs == longer) if cases[k] in before]
        after, earlier = np.array(steps).T
        ratios = [geometric_mean(results.errors(e)[after] / results.errors(e)[earlier]) for e in errors]
        step = f"{looked[earlier].mean():.1f} to {looked[after].mean():.1f}"
        rows.append([step, len(steps), *(each.text() for each in ratios)])
    columns = f"revolutions seen | runs | {' | '.join(error.title for error in errors)}"
    return Part("Errors over those of the next shorter look", columns, rows)


def _growth_with_revolutions(results: Results, looked: Array, what: str, values: pd.Series) -> Part:
    """Exponents of the revolutions, of all runs and of each group."""
    groups = {"all": np.ones(len(looked), bool)}
    groups |= {f"{what} {v}" if what == BODY else str(v): (values == v).to_numpy() for v in values.unique()}
    rows = []
    for error in ERRORS:
        cells = []
        for at in groups.values():
            found = powers(results.errors(error)[at], {"revolutions": looked[at]})
            cells.append("-" if found is None else found.exponents["revolutions"].fixed())
        rows.append([error.title, *cells])
    return Part(f"Exponent of the revolutions, by {what}", f"error | {' | '.join(groups)}", rows)


def _axes_with_body(results: Results) -> list[Axis]:
    """What was varied, and the body, which the seed draws."""
    seeds = results.settings["seed"].astype(str)
    labels = tuple(dict.fromkeys(seeds))
    body = Axis(BODY, np.array([float(labels.index(each)) for each in seeds]), labels)
    return [*axes_of(results.study, results.table), body]


def _bodies_at_the_ends(results: Results, looked: Array) -> Part:
    """What is known of each body after the shortest and the longest look."""
    pairs, rows = pairs_of(results), []
    for count in (pairs.min(), pairs.max()):
        for body, own in _by_body(results).items():
            at = own & (pairs == count)
            values = [results.errors(error)[at] for error in (AXES, K1, PREDICTION, RATE)]
            said = f"{int(np.nansum(results.column('run.identifiable.axes')[at]))} of {int(at.sum())}"
            ranges = [f"{significant(v.min())} to {significant(v.max())}" for v in values]
            rows.append([f"{looked[at].mean():.1f}", body, *ranges, said])
    columns = (
        f"revolutions seen | body | {AXES.title} | k1 | {PREDICTION.title} | {RATE.title} | axes determined"
    )
    return Part("The least and the largest error of the three motions", columns, rows, right_from=0)


def _degraded(results: Results, looked: Array) -> Part:
    """Errors of runs that doubt themselves, beside those of runs that are ok."""
    rows = []
    for error in (PREDICTION, RATE):
        values = results.errors(error)
        found = powers(np.where(results.ok, values, np.nan), {"revolutions": looked})
        if found is None:
            continue
        power = found.exponents["revolutions"].value
        residual = np.log(values) - power * np.log(looked)
        residual = (residual - np.nanmean(residual[results.ok])) / found.sigma
        doubted = results.done & ~results.ok
        cells = [f"{each:+.1f}" for each in residual[doubted]]
        rows.append([error.title, int(doubted.sum()), ", ".join(cells)])
    title = "Runs that are degraded: distance from the fit to those that are ok, in its standard deviations"
    return Part(title, "error | runs | distances", rows)


def revolutions_or_pairs(frame_rate: Results, inertia: Results) -> list[Part]:
    """Does it matter how many pairs there are, or how far the target turns meanwhile?"""
    both: Sequence[tuple[str, Results]] = (("frame rate", frame_rate), ("inertia", inertia))
    used = [each.ok & (rate_deg_s(each) * interval_s(each) < CLEAR_DEG) for _, each in both]

    def joined(values: Sequence[Array]) -> Array:
        return np.concatenate([own[at] for own, at in zip(values, used, strict=True)])

    by = {
        "revolutions": joined([revolutions(each) for _, each in both]),
        "pairs": joined([pairs_of(each) for _, each in both]),
        "rate": joined([rate_deg_s(each) for _, each in both]),
    }
    # each body of each study has a factor of its own
    groups = [
        (name, seed)
        for (name, each), at in zip(both, used, strict=True)
        for seed in each.settings["seed"][at]
    ]
    errors = [(error, joined([each.errors(error) for _, each in both])) for error in ERRORS]
    return [exponents("Exponents of both studies together, of runs that are ok", errors, by, groups)]
