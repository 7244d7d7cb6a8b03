"""Rules of thumb beside runs that they were not fitted to."""

from typing import Any

import numpy as np
import pytest

from benchmarks.studies.expectations import compared, observation_of_scene
from benchmarks.studies.random_scenes import random_scenes
from benchmarks.studies.rules_of_thumb import ERRORS, rules_of
from polhode.studies.study import open_study
from tests.benchmarks.studies.test_findings import invented
from tests.benchmarks.studies.test_rules_of_thumb import table_of
from tests.docs.page_code import ROOT

RULES = rules_of(random_scenes(96), table_of(96, 0.3))
"""Errors are the inverse of the pixels across the target"""


def follows(factor: float) -> Any:
    """Runs of the ready study of light: 100 px across, and errors so many times as large as the rules say."""

    def outcome(values: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        del values
        rate = 6.0 * float(np.linalg.norm([0.8, 2.0, 1.0]))
        scale = {"size": 0.3, "rate": rate}
        noise = factor * float(np.exp(0.3 * rng.normal()))
        return {e["quantity"]: scale.get(e.get("over", ""), 1.0) * noise / 100.0 for e in ERRORS}

    return outcome


def test_bands_hold_for_runs_that_follow_the_rules_and_not_for_others() -> None:
    study = open_study(ROOT / "configs" / "studies" / "light.yaml")
    within = [observation_of_scene(study.config(study.point(k))) for k in range(study.count)]
    # half of the points have a lamp, and of the others 8 a Sun 105 and 8 one 135 degrees from the camera
    assert sum(each is not None for each in within) == 20
    assert within[0] is not None and within[0].sun_angle_deg == pytest.approx(17.5, abs=3.0)
    rows = [list(row) for row in compared(RULES, invented("light", follows(1.0)))]
    assert [row[1] for row in rows] == [12] * 4 and rows[0][0] == "Light"
    assert all(int(str(row[3]).split()[0]) >= 9 for row in rows)
    for row in compared(RULES, invented("light", follows(10.0))):
        assert str(list(row)[3]).startswith("0 of 12") and 8.0 < float(str(list(row)[4]).split()[0]) < 12.0
