"""The scenes and the fit of the rules of thumb, with invented errors."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from benchmarks.studies import expectations
from benchmarks.studies.expectations import FITTED, RESULTS
from benchmarks.studies.random_scenes import RANGES, random_scenes
from benchmarks.studies.rules_of_thumb import (
    AXIS,
    ERRORS,
    MIN_RUNS,
    main,
    observation_of,
    report,
    rules_of,
    study_of,
)
from polhode.output.marked_folder import claim
from polhode.studies.rules import CONFIDENCE, SHIPPED, expected, read_rules
from polhode.studies.study import open_study
from polhode.studies.table import COMMAND, FILES, TABLE
from tests.docs.page_code import ROOT

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


def assert_same_but_for_rounding(found: object, shipped: object) -> None:
    """Processors sum in other orders: a fit of some hundred rows keeps 10 of the 16 digits."""
    if isinstance(found, dict) and isinstance(shipped, dict):
        assert found.keys() == shipped.keys()
        for key in found:
            assert_same_but_for_rounding(found[key], shipped[key])
    elif isinstance(found, list) and isinstance(shipped, list):
        for one, other in zip(found, shipped, strict=True):
            assert_same_but_for_rounding(one, other)
    elif isinstance(found, float):
        assert found == pytest.approx(shipped, rel=1e-10, abs=1e-12)
    else:
        assert found == shipped


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
    assert {rule.new for rule in found.rules} == {0}
    assert found.rules[0].coefficients[1] == pytest.approx(-1.0, abs=0.3)


def test_runs_that_are_held_back_are_in_no_fit_and_are_counted(tmp_path: Path, capsys: Capture) -> None:
    scenes, table, output = random_scenes(128), table_of(128, 0.3), tmp_path / "rules.yaml"
    report(scenes, table, output, held_back=30)
    found, printed = read_rules(output), capsys.readouterr().out
    assert "128 scenes, 116 of them with an answer, 30 of these held back" in printed
    assert (found.runs, found.failed) == (98, 12)
    # the same fit without them
    answered = [k for k, each in enumerate(table.column("status").to_pylist()) if each == "done"]
    without = rules_of(scenes, table.take([k for k in range(128) if k not in answered[-30:]]))
    for rule, other, about in zip(found.rules, without.rules, ERRORS, strict=True):
        assert rule.coefficients == other.coefficients and (rule.new, other.new) == (30, 0)
        column = table.column(about["quantity"]).to_pylist()
        inside = 0
        for k in answered[-30:]:
            (band,) = (e for e in expected(found, observation_of(scenes[k])) if e.quantity == rule.quantity)
            inside += band.low <= column[k] <= band.high
        assert rule.new_inside == inside
        assert f"{inside} of 30 (" in printed
    # of 120 independent errors, a band of 90 % holds 98 to 116 with a probability of 99.9 %
    assert 98 <= sum(rule.new_inside for rule in found.rules) <= 116
    assert CONFIDENCE == 0.9


def test_rules_that_new_runs_contradict_are_not_written(tmp_path: Path, capsys: Capture) -> None:
    table, output = table_of(128, 0.1), tmp_path / "rules.yaml"
    name = ERRORS[0]["quantity"]
    # the last of them are much worse than the fit can know
    worse = [each * (9.0 if k > 110 else 1.0) for k, each in enumerate(table.column(name).to_pylist())]
    place = table.column_names.index(name)
    report(random_scenes(128), table.set_column(place, name, pa.array(worse)), output, held_back=30)
    said = f"of 30 runs that were held back are inside for {name}"
    assert said in capsys.readouterr().out and not output.exists()


def test_stored_runs_are_fitted_without_a_sweep(tmp_path: Path, capsys: Capture) -> None:
    folder, output = tmp_path / "rules", tmp_path / "rules.yaml"
    claim(folder, COMMAND, FILES)
    pq.write_table(table_of(96, 0.3), folder / TABLE)
    main(folder, output, stored=True)
    assert "96 scenes, 87 of them with an answer, 0 of these held back" in capsys.readouterr().out
    assert read_rules(output).runs == 96
    with pytest.raises(SystemExit, match="--held-back -1: give 0 or more runs"):
        main(folder, output, held_back=-1, stored=True)


def test_the_page_has_the_tables_and_the_rules_of_this_version_are_theirs(
    tmp_path: Path, capsys: Capture
) -> None:
    page = (ROOT / "docs" / "expect.md").read_text()
    main(RESULTS / FITTED, tmp_path / "rules.yaml", held_back=30, stored=True)
    printed = capsys.readouterr().out
    expectations.main()
    printed += capsys.readouterr().out
    rows = {line for line in printed.splitlines() if line.startswith("|")}
    assert rows <= set(page.splitlines())
    assert "Of all 120 errors held back, 112 are inside" in page and "112 of 120" in printed
    main(RESULTS / FITTED, tmp_path / "again.yaml", held_back=30, stored=True)
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "rules.yaml").read_bytes()
    assert_same_but_for_rounding(
        yaml.safe_load((tmp_path / "rules.yaml").read_text()), yaml.safe_load(SHIPPED.read_text())
    )
