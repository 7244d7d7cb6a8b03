"""Ratios to the default are those of the same scene."""

import numpy as np
import pandas as pd

from benchmarks.frontend.leading import (
    BASE,
    ERRORS,
    STUDY,
    by_scene,
    ratios_of,
    rows_of_features,
    rows_of_scenes,
)
from polhode.studies.study import open_study


def invented() -> pd.DataFrame:
    """Three scenes: the other front end halves all errors of one, doubles those of one, and fails in one."""
    rows = []
    for scene, factor in (("calm", 0.5), ("hard", 2.0), ("dark", np.nan)):
        for features, scale in ((BASE, 1.0), ("other", factor)):
            errors = {name: scale * 0.1 for name, _ in ERRORS.values()}
            counts = {"run.frames": 60, "run.frames_used": 58, "time.run_s": 12.0}
            verdict, status = (None, "failed") if np.isnan(scale) else ("ok", "done")
            names = {"scene": scene, "features": features, "verdict": verdict, "status": status}
            rows.append({**names, **errors, **counts})
    return pd.DataFrame(rows)


def test_ratios_are_to_the_default_of_the_same_scene() -> None:
    assert np.array_equal(ratios_of(by_scene(invented()), "other"), [[0.5] * 4, [2.0] * 4])
    (row,) = rows_of_features(invented())
    assert row == ["other", "2", *["1.00"] * 5, "1 of 2"]
    cells = list(rows_of_scenes(invented(), ["other", "absent"]))
    assert cells[0][:2] == ["calm (58 of 60)", "100.000"] and cells[0][6] == "-"
    assert [row[5] for row in cells] == [
        "0.50, 0.50, 0.50, 0.50 (58 of 60)",
        "2.00, 2.00, 2.00, 2.00 (58 of 60)",
        "none (failed, 58 of 60)",
    ]


def test_the_study_compares_the_default_with_others() -> None:
    study = open_study(STUDY)
    points = [study.point(number).values for number in range(study.count)]
    names = {str(values["features"]) for values in points}
    assert BASE in names and len(names) == 4
    assert len({str(values["scene"]) for values in points}) == study.sequences == 16
