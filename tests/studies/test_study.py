"""Studies as they are read: points, addresses, and what is refused."""

from pathlib import Path
from typing import Any

import pytest

from polhode.cli.main import main
from polhode.config import Scene
from polhode.runtime.errors import InputError
from polhode.studies import study as study_module
from polhode.studies.forecast import forecast
from polhode.studies.study import open_study
from tests.docs.page_code import ROOT, fences
from tests.studies.conftest import BASELINES, SCENE, WriteStudy

Capture = pytest.CaptureFixture[str]
GRID: dict[str, Any] = {
    "base": {"scene": SCENE},
    "axes": {BASELINES: [0.1, 0.2], "seed": {"range": [1, 3], "count": 3}},
    "steps": ["simulate"],
}


def test_points_are_a_grid_in_which_a_design_is_one_factor(write_study: WriteStudy) -> None:
    study = open_study(write_study(**GRID))
    assert (study.count, study.sequences) == (6, 6)
    points = [study.point(number).values for number in range(6)]
    # the first axis is the slowest
    assert points == [{BASELINES: b, "seed": s} for b in (0.1, 0.2) for s in (1, 2, 3)]
    design = {"method": "sobol", "count": 4, "settings": {"scene.interval_s": {"uniform": [1, 2]}}}
    study = open_study(write_study(**GRID, design=design))
    assert study.count == 24 and study.columns == (BASELINES, "seed", "scene.interval_s")
    assert len({study.point(number).values["scene.interval_s"] for number in range(24)}) == 4
    # as listed points are
    study = open_study(write_study(points=[{"seed": 1, "scene": {"frames": 2}}, {"seed": 2}], steps=[]))
    assert [study.point(k).values for k in (0, 1)] == [
        {"seed": 1, "scene.frames": 2},
        {"seed": 2, "scene.frames": None},
    ]
    # sequences are counted once, however many points use them
    axes = {BASELINES: [0.1, 0.2, 0.3], "backend.accel_psd": {"log_range": [1e-6, 1e-3], "count": 50}}
    study = open_study(write_study(base={"scene": SCENE}, axes=axes, steps=["simulate", "run"]))
    assert (study.count, study.sequences) == (150, 3)


def test_settings_are_laid_over_the_base_down_to_elements_of_lists(write_study: WriteStudy) -> None:
    axes = {"scene.motion.position_m.1": [0.5], "backend.accel_psd": [1e-3]}
    base = {"scene": SCENE, "runtime": {"workers": 7}}
    study = open_study(write_study(base=base, axes=axes, steps=[]))
    config = study.config(study.point(0))
    assert config.scene is not None and config.scene.motion.position_m == (0.04, 0.5, 0.6)
    assert config.backend.accel_psd == 1e-3 and config.scene.rig.width_px == 48
    # every point is computed by one process
    assert config.runtime.workers == 1
    # steps of a point that contradict each other are found when it is made
    axes = {"key_frames.above": [100, 600], "key_frames.number": [50, 200]}
    study = open_study(write_study(axes=axes, steps=[]), check=False)
    study.config(study.point(0))
    with pytest.raises(InputError, match="200 key frames are more than above: 100"):
        study.config(study.point(1))


def test_base_and_variants_can_be_files_relative_to_the_study(
    write_study: WriteStudy, tmp_path: Path
) -> None:
    write_study("parent", scene=SCENE, seed=5)
    write_study("scene", extends="parent.yaml", backend={"accel_psd": 1e-2})
    write_study("light", scene={"light": {"earth": 0.5}})
    variants = {"dark": {"scene.light.earth": 0.0}, "lit": "light.yaml"}
    study = open_study(write_study(base="scene.yaml", axes={"light": {"variants": variants}}, steps=[]))
    configs = [study.config(study.point(number)) for number in (0, 1)]
    assert [each.seed for each in configs] == [5, 5]
    assert [each.scene.light.earth for each in configs if each.scene] == [0.0, 0.5]
    written = tmp_path / "elsewhere.yaml"
    written.write_text(study.text())
    for name in ("scene", "parent", "light"):
        (tmp_path / f"{name}.yaml").unlink()
    again = open_study(written)
    assert [again.point(n).address for n in (0, 1)] == [study.point(n).address for n in (0, 1)]


def test_an_address_depends_on_all_that_decides_the_result_and_on_nothing_else(
    write_study: WriteStudy, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def address(number: int = 0, **other: Any) -> str:
        return open_study(write_study(**{**GRID, **other})).point(number).address

    first = address()
    same = (address(title="another"), address(base={"scene": SCENE, "runtime": {"workers": 3}}))
    assert set(same) == {first}
    # the same point in another grid
    assert address(axes={BASELINES: [0.1], "seed": [4, 1]}, number=1) == first
    others = [
        address(number=1),
        address(base={"scene": {**SCENE, "frames": 2}}),
        address(steps=["simulate", "run"]),
        address(keep="whole"),
    ]
    monkeypatch.setattr(study_module, "code_digest", lambda: "of a later version")
    others.append(address())
    assert len({first, *others}) == len(others) + 1
    # an address depends on the content of files
    mesh = tmp_path / "body.obj"
    body = {"family": "mesh", "path": str(mesh), "metres_per_unit": 1.0}

    def of_content(content: str) -> str:
        mesh.write_text(content)
        study_module.file_digest.cache_clear()
        return open_study(write_study(base={"scene": {**SCENE, "body": body}}, steps=[])).point(0).address

    assert of_content("v 0 0 0\n") != of_content("v 0 0 1\n")


BASELINE_DRAWS = {"uniform": [1, 2], "count": 1000}
BAD: dict[str, dict[str, Any]] = {
    "key 'plan.members': must be at least 60": {
        "steps": ["simulate", "run", "plan"],
        "plan": {"members": 50},
    },
    "unknown key 'axis'; did you mean axes?": {"axis": {}},
    "unknown key 'scene.framez'; did you mean frames?": {"axes": {"scene.framez": [1]}},
    "'scen.frames' is no setting; it begins with one of": {"axes": {"scen.frames": [1]}},
    "unknown key 'axes.seed.linear'": {"axes": {"seed": {"linear": [1, 2]}}},
    "give exactly one of": {"axes": {"seed": {"range": [1, 2], "values": [1]}}},
    "values: the list is empty": {"axes": {"seed": []}},
    "the range from 2 to 2 is empty": {"axes": {"seed": {"range": [2, 2], "count": 3}}},
    "the range from 3 to 2 is empty": {"axes": {"seed": {"uniform": [3, 2], "count": 3}}},
    "the range from 4 to 4 is empty": {"design": {"count": 4, "settings": {"seed": {"uniform": [4, 4]}}}},
    "count is missing": {"axes": {"seed": {"range": [1, 2]}}},
    "must be above 0": {"axes": {"seed": {"log_range": [0, 2], "count": 2}}},
    "axes: key 'scene.frames': must be at least": {"axes": {"scene.frames": [3, -1]}},
    "axes: key 'scene.body.contrast': must be at least 0": {
        "axes": {"scene.body.contrast": {"normal": [0, 1], "count": 30}}
    },
    "expected a whole number": {"axes": {"scene.frames": ["many"]}},
    "1,000,000,000 points (seed 1000000 x scene.rig.baseline_m 1000) are more than 1,000,000": {
        "axes": {"seed": {"range": [0, 9e5], "count": 10**6}, BASELINES: BASELINE_DRAWS}
    },
    "524,288,000 points (scene.rig.baseline_m 1000 x design 524288) are more than 1,000,000": {
        "axes": {BASELINES: BASELINE_DRAWS},
        "design": {"method": "sobol", "count": 2**19, "settings": {"seed": {"uniform": [0, 1e9]}}},
    },
    "comes twice": {"points": [{"seed": 1}, {"seed": 1}]},
    "'sed' is no setting": {"points": [{"sed": 1}]},
    "is set by seed and by seed": {"points": [{"seed": 1}], "axes": {"seed": [1]}},
    "points, design: both name settings": {
        "points": [{"seed": 1}],
        "design": {"count": 1, "settings": {"seed": {"values": [1]}}},
    },
    "give 64 or 128": {
        "design": {"method": "sobol", "count": 100, "settings": {"seed": {"uniform": [1, 2]}}}
    },
    "unknown key 'scene.framex'": {"design": {"count": 4, "settings": {"scene.framex": {"uniform": [1, 2]}}}},
    "'scene.rig.baseline_m' is set by scene.rig and by scene.rig.baseline_m": {
        "axes": {"scene.rig": [{}], BASELINES: [0.1]}
    },
    "how the machine is used does not change a result": {"axes": {"runtime.workers": [1, 2]}},
    "the table has a column": {"axes": {"status": {"variants": {"a": {"seed": 1}}}}},
    "'evaluate' needs a run": {"steps": ["simulate", "evaluate"]},
    "a run needs a sequence": {"steps": ["run"]},
    "no 'scene' to simulate": {"base": {}, "steps": ["simulate"]},
    "in this order": {"steps": ["run", "simulate"]},
    "expected": {"steps": ["render"]},
    "remove it, or the step simulate": {"data": "nowhere", "steps": ["simulate"]},
    "nowhere is missing": {"data": "nowhere", "steps": ["run"]},
    "nowhere.yaml is missing": {"base": "nowhere.yaml"},
    "is missing: give an existing study": {},
}


@pytest.mark.parametrize("said", BAD)
def test_a_bad_study_gives_one_line_before_anything_runs(
    said: str, write_study: WriteStudy, tmp_path: Path, capsys: Capture
) -> None:
    path = write_study(**{"base": {"scene": SCENE}, "steps": [], **BAD[said]})
    if not BAD[said]:
        path.unlink()
    assert main(["sweep", str(path), "-o", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("polhode: error: ") and printed.err.count("\n") == 1
    assert said in printed.err and str(tmp_path) in printed.err
    assert not (tmp_path / "out").exists()


def test_a_dry_run_of_many_points_prints_the_plan_and_writes_nothing(
    write_study: WriteStudy, tmp_path: Path, capsys: Capture
) -> None:
    axes = {
        BASELINES: {"range": [0.1, 0.2], "count": 10},
        "backend.accel_psd": {"log_range": [1e-6, 1e-3], "count": 1000},
    }
    path = write_study(base={"scene": SCENE}, axes=axes)
    assert main(["sweep", str(path), "-o", str(tmp_path / "out"), "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "points      10,000 (scene.rig.baseline_m 10 x backend.accel_psd 1000)" in text
    assert "rendered    10 sequences, each once; 10 stereo pairs" in text
    assert not (tmp_path / "out").exists()
    # variants with scenes take their defaults and their own sizes
    scene = Scene()
    small = {"frames": 10, "rig": {"width_px": 100, "height_px": 50}}
    variants = {"small": {"scene": small}, "by default": {"scene": {"interval_s": 1.0}}}
    study = open_study(write_study(base={}, axes={"size": {"variants": variants}}, steps=["simulate"]))
    assert forecast(study)["pairs"] == 10 + scene.frames
    different = {"scene.frames": [2, 10], "seed": [1, 2, 3]}
    grid = open_study(write_study(base={"scene": SCENE}, axes=different, steps=["simulate"]))
    assert forecast(grid)["pairs"] == 3 * 12


def test_the_study_of_the_page_is_one(tmp_path: Path) -> None:
    (example,) = (fence for fence in fences("studies.md") if fence.language == "yaml")
    (tmp_path / "studies").mkdir()
    (tmp_path / "scenes").symlink_to(ROOT / "configs" / "scenes")
    (tmp_path / "studies" / "study.yaml").write_text(example.body)
    study = open_study(tmp_path / "studies" / "study.yaml")
    assert (study.count, study.sequences) == (5 * 4 * 2 * 16, 5 * 4 * 16)
    assert study.columns[2] == "front end"


FULL_SIZE = "front_ends_of_scenes"
"""The ready study whose images are those of the scenes"""
READY = sorted((ROOT / "configs" / "studies").glob("*.yaml"))


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_a_ready_study_can_be_computed_and_all_fit_a_night(path: Path) -> None:
    study = open_study(path)
    assert f"`{path.name}`" in (ROOT / "docs" / "studies.md").read_text()
    if path.stem == FULL_SIZE:
        assert study.count <= 100
    else:
        # nine of them: two processes for ten hours, a point in two minutes
        assert 16 <= study.count <= 45
        assert not (study.sequences and study.settings.keep_sequences)
    assert study.settings.title
    study.config(study.point(study.count - 1))
