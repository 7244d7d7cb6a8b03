"""``--data`` and ``--run`` with the truth of a dataset: it gives errors, and changes nothing else."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.compare.problem import sources
from polhode.compare.problem.sources import measure
from polhode.compare.rows import Comparison, read_comparison
from polhode.config import Config
from polhode.pipeline import correspondences
from polhode.report.evaluation import truth_of_frames
from polhode.run_directory.archives import read_measurements
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from tests.conftest import RENDERED_FRAMES

CONFIG = Config.model_validate({"runtime": {"workers": 1}})
OPTIONS = ["--runtime.workers", "1", "--compare.solvers", "gauss_newton,odometry"]
ONE_METHOD = "frontend: {features: {second: null}, depth: {method: sgbm}}\n"
"""One method of the front end, where it is asked what the truth changes, not how much two methods see."""
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("config") / "config.yaml"
    path.write_text("compare: {limit_s: 60, total_s: 200}\n" + ONE_METHOD)
    return path


@pytest.fixture(scope="module")
def of_data(rendered_sequence: Path, config: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("compared") / "out"
    assert main(["compare", str(config), "--data", str(rendered_sequence), "-o", str(out), *OPTIONS]) == 0
    return out


def without_errors(comparison: Comparison) -> list[tuple[object, ...]]:
    """What the solvers found, times aside."""
    return [(row.solver, row.status, row.cost, row.k1, row.k2, row.iterations) for row in comparison.rows]


def test_a_dataset_is_measured_solved_and_judged_by_its_truth(of_data: Path, rendered_sequence: Path) -> None:
    found = read_comparison(of_data / "compare.json")
    assert found.problems[0].truth and found.problems[0].frames == RENDERED_FRAMES
    (ours, odometry) = found.rows
    assert ours.status == "ok" and ours.errors is not None and odometry.errors is not None
    assert ours.errors.attitude_deg < 1.0
    truth = truth_of_frames(
        rendered_sequence, read_measurements(of_data / "problems" / "rendered.npz").timestamps_ns
    )
    assert truth is not None and ours.k1 is not None
    assert ours.errors.k1 == pytest.approx(ours.k1 - truth.k1, abs=1e-12)
    page = (of_data / "compare.html").read_text()
    assert "Estimate minus truth" in page and f">{ours.errors.k1:+.4f}<" in page
    header, first = (line.split(",") for line in (of_data / "compare.csv").read_text().splitlines()[:2])
    assert float(first[header.index("error_position_mm")]) == ours.errors.position_mm


def test_the_truth_reaches_no_solver(
    of_data: Path, rendered_sequence: Path, config: Path, tmp_path: Path
) -> None:
    blind = tmp_path / "sequence"
    shutil.copytree(rendered_sequence, blind)
    shutil.rmtree(blind / "mav0" / "target0")
    out = tmp_path / "out"
    assert main(["compare", str(config), "--data", str(blind), "-o", str(out), *OPTIONS]) == 0
    found, with_truth = read_comparison(out / "compare.json"), read_comparison(of_data / "compare.json")
    assert without_errors(found) == without_errors(with_truth)
    assert "Estimate minus truth" not in (out / "compare.html").read_text()
    assert not found.problems[0].truth and all(row.errors is None for row in found.rows)


def test_a_run_is_judged_by_the_truth_of_its_sequence(
    of_data: Path, rendered_sequence: Path, config: Path, tmp_path: Path
) -> None:
    run, out = tmp_path / "sequence", tmp_path / "out"
    run.mkdir()
    shutil.copy(of_data / "problems" / "rendered.npz", run / "measurements.npz")
    command = ["compare", str(config), "--run", str(run), "-o", str(out), *OPTIONS]
    assert main([*command, "--truth", str(rendered_sequence)]) == 0
    found, known = read_comparison(out / "compare.json"), read_comparison(of_data / "compare.json")
    assert without_errors(found) == without_errors(known)
    assert [row.errors for row in found.rows] == [row.errors for row in known.rows]
    assert found.problems[0].fingerprint == known.problems[0].fingerprint


def test_the_measurements_of_a_run_with_all_methods_give_small_errors(
    finished: Path, rendered_sequence: Path, config: Path, tmp_path: Path
) -> None:
    command = ["compare", str(config), "--run", str(finished), "-o", str(tmp_path / "out"), *OPTIONS]
    assert main([*command, "--truth", str(rendered_sequence)]) == 0
    ours = read_comparison(tmp_path / "out" / "compare.json").rows[0]
    assert ours.status == "ok" and ours.errors is not None
    assert ours.errors.position_mm < 2.0 and ours.errors.attitude_deg < 1.0


def test_the_front_end_runs_once_for_the_same_images_and_settings(
    of_data: Path, rendered_sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = CONFIG.model_copy(update={"scene": None})
    store = tmp_path / "sequence"
    for suffix in (".npz", ".json"):
        shutil.copy(of_data / "problems" / f"rendered{suffix}", store.with_suffix(suffix))
    stamp = json.loads(store.with_suffix(".json").read_text())
    monkeypatch.setattr(sources, "_stamp", lambda *_: stamp)
    monkeypatch.setattr(correspondences, "match_frames", lambda *_: pytest.fail("matched again"))
    tracks, relative = measure(rendered_sequence, config, Silent(), store)
    assert tracks.n_frames == RENDERED_FRAMES and relative is not None
    # other settings are other measurements
    monkeypatch.setattr(sources, "_stamp", lambda *_: {**stamp, "settings": ""})
    monkeypatch.setattr(correspondences, "match_frames", _matched)
    with pytest.raises(InputError, match="matched again"):
        measure(rendered_sequence, config, Silent(), store)


def _matched(*_: object) -> None:
    raise InputError("matched again")


def test_a_truth_that_does_not_cover_the_frames_is_refused(rendered_sequence: Path) -> None:
    late = np.array([10**18, 10**18 + 10**9], dtype=np.int64)
    with pytest.raises(InputError, match="does not cover the run"):
        truth_of_frames(rendered_sequence, late)
    assert truth_of_frames(rendered_sequence / "mav0", late) is None
