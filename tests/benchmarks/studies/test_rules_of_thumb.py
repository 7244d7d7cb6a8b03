"""The scenes and the fit of the rules of thumb, with invented errors."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import yaml

from benchmarks.studies.random_scenes import RANGES, random_scenes
from benchmarks.studies.rules_of_thumb import (
    AXIS,
    ERRORS,
    MIN_RUNS,
    observation_of,
    report,
    study_of,
)
from polhode.studies.rules import read_rules
from polhode.studies.study import open_study

Capture = pytest.CaptureFixture[str]


def table_of(count: int, scatter: float) -> pa.Table:
    """Errors that follow the pixels of the target; every tenth scene has none."""
    rng, scenes = np.random.default_rng(4), random_scenes(count)
    seen = [observation_of(each) for each in scenes]
    columns: dict[str, list[object]] = {
        AXIS: [each.name for each in scenes],
        "status": ["failed" if k % 10 == 9 else "done" for k in range(count)],
    }
    for about in ERRORS:
        columns[about["quantity"]] = [
            each.scale(about.get("over", "nothing"))
            * np.exp(scatter * rng.normal())
            / each.predictors["size_px"]
            for each in seen
        ]
    return pa.table(columns)


def test_a_scene_is_the_same_however_many_are_drawn_and_within_the_ranges() -> None:
    few, many = random_scenes(8), random_scenes(32)
    assert many[:8] == few
    for each in many:
        low, high = RANGES["size_px"]
        assert 0.99 * low <= observation_of(each).predictors["size_px"] <= 1.01 * high


def test_the_scenes_are_a_study(tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(yaml.safe_dump(study_of(random_scenes(4)), sort_keys=False))
    study = open_study(path)
    assert (study.count, study.sequences) == (4, 4)


def test_enough_runs_give_rules_and_few_do_not(tmp_path: Path, capsys: Capture) -> None:
    output = tmp_path / "rules.yaml"
    report(random_scenes(40), table_of(40, 0.3), output)
    said = f"no rules are written: evaluate.attitude_error_deg.median has 36 runs, and {MIN_RUNS} are needed"
    assert said in capsys.readouterr().out and not output.exists()
    report(random_scenes(16), table_of(16, 0.3), output)
    assert "too few for any fit" in capsys.readouterr().out and not output.exists()
    report(random_scenes(96), table_of(96, 0.3), output)
    assert "rules: " in capsys.readouterr().out
    found = read_rules(output)
    assert (found.runs, found.failed, len(found.rules)) == (96, 9, len(ERRORS))
    assert found.rules[0].coefficients[1] == pytest.approx(-1.0, abs=0.3)
