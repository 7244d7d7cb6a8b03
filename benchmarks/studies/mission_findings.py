"""Findings on one mission whose unknowns are drawn: errors, predictions, and broken keep-out volumes."""

import re

import numpy as np
from pandas.api.types import is_numeric_dtype

from benchmarks.studies.confidence import (
    CONFIDENCE,
    median,
    quantile,
    rank_correlation,
    share_text,
    significant,
)
from benchmarks.studies.effects import determined, doubts, outcomes, sigmas
from benchmarks.studies.study_results import ATTITUDE, RATE, SURFACE, Error, Part, Results, prediction

BROKEN = re.compile(r"plan\.truth\.(?P<volume>[a-z]+)_(?P<part>[a-z]+)_left")
VOLUMES = {"swept": "swept over the horizon", "instant": "of each instant"}
PARTS = {"body": "the whole body", "seen": "what was seen in light"}


def one_mission(results: Results) -> list[Part]:
    """How are errors, predictions and keep-out volumes distributed?"""
    return [
        outcomes(results),
        _distribution(results, _errors(results)),
        _broken(results),
        _farthest(results),
        _what_decides(results, _errors(results)),
        determined(results),
        sigmas(results),
        doubts(results),
    ]


def _errors(results: Results) -> list[Error]:
    """Errors that some point has."""
    among = [prediction(10), prediction(30), ATTITUDE, RATE, SURFACE]
    among.append(Error("prediction of position, 30 s [mm]", "evaluate.prediction_error_m.30", 1e3))
    among.append(Error("keep-out volume [m3]", "plan.keepout.volume_m3"))
    return [each for each in among if np.isfinite(results.errors(each)).any()]


def _distribution(results: Results, errors: list[Error]) -> Part:
    """Medians and nine tenths of the missions."""
    rows = []
    for error in errors:
        values = results.errors(error)
        rows.append([error.title, median(values).count, median(values).text(), quantile(values, 0.9).text()])
    return Part("Distribution", "result | missions | median | nine of ten are below", rows)


def _broken(results: Results) -> Part:
    """How often the true body left a keep-out volume."""
    rows = []
    for name in results.table.column_names:
        match = BROKEN.fullmatch(name)
        if match is None:
            continue
        left, farthest = results.column(name), results.column(name.replace("_left", "_farthest_m"))
        for among, at in (("all", np.isfinite(left)), ("ok", np.isfinite(left) & results.ok)):
            share = share_text(int(left[at].sum()), int(at.sum()))
            out = 1e3 * farthest[at & (left == 1.0)]
            said = f"{out.max():.1f}" if len(out) else "-"
            where = [VOLUMES.get(match["volume"], match["volume"]), PARTS.get(match["part"], match["part"])]
            rows.append([*where, among, share, said])
    columns = "volume | what leaves it | runs | missions | farthest [mm]"
    return Part("Keep-out volumes that the true body left", columns, rows, right_from=3)


def _farthest(results: Results) -> Part:
    """Of each mission whose body left a volume of an instant: can the error of the motion explain how far?"""
    left, farthest = (results.column(f"plan.truth.instant_body_{name}") for name in ("left", "farthest_m"))
    errors = (prediction(30), Error("position, 30 s [mm]", "evaluate.prediction_error_m.30", 1e3))
    rows = [
        [
            k,
            results.verdict[k],
            *(significant(float(results.errors(e)[k])) for e in errors),
            f"{1e3 * far:.0f}",
        ]
        for k, far in enumerate(farthest)
        if left[k] == 1.0
    ]
    columns = f"mission | run | {' | '.join(error.title for error in errors)} | farthest [mm]"
    return Part("Missions whose body left the volume of an instant", columns, rows, right_from=2)


def _what_decides(results: Results, errors: list[Error]) -> Part:
    """Rank correlations of errors with each unknown; intervals hold for all of a column together."""
    settings = [name for name in results.study.columns if name not in results.seeds]
    # Bonferroni: of so many correlations one would be found by chance
    together = 1.0 - (1.0 - CONFIDENCE) / max(len(settings), 1)
    rows = []
    for name in settings:
        if not is_numeric_dtype(results.settings[name]):
            continue
        values = results.column(name)
        cells = [rank_correlation(values, results.errors(error), together).fixed() for error in errors]
        rows.append([name, *cells])
    return Part("Rank correlations", f"unknown | {' | '.join(error.title for error in errors)}", rows)
