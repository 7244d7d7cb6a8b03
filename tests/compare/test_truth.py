"""``--data`` and ``--run`` with the truth of a dataset: it gives errors, and changes nothing else."""

from pathlib import Path

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.compare.problem import sources
from polhode.compare.problem.sources import measure
from polhode.compare.rows import read_comparison
from polhode.config.loader import load_config
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.report.evaluation import truth_of_frames
from polhode.run_directory.archives import write_measurements
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from tests.conftest import RENDERED_FRAMES
from tests.front_end_results import SharedFrontEnd

Measurements = tuple[StereoTracks, RelativePoses | None]
OPTIONS = ["--runtime.workers", "1", "--compare.solvers", "gauss_newton,odometry"]
ONE_METHOD = "frontend: {features: {second: null}, depth: {method: sgbm}}\n"
"""One method of the front end, where it is asked what the truth changes, not how much two methods see."""


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("config") / "config.yaml"
    path.write_text("compare: {limit_s: 60, total_s: 200}\n" + ONE_METHOD)
    return path


@pytest.fixture(scope="module")
def measured(rendered_sequence: Path, config: Path, front_end_once: SharedFrontEnd) -> Measurements:
    with front_end_once():
        return measure(rendered_sequence, load_config(config, {"runtime.workers": 1}), Silent())


@pytest.fixture(scope="module")
def of_data(
    rendered_sequence: Path, config: Path, measured: Measurements, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    out = tmp_path_factory.mktemp("compared") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sources, "measure", lambda *_: measured)
        words = ["compare", str(config), "--data", str(rendered_sequence), "-o", str(out), *OPTIONS]
        assert main(words) == 0
    return out


def test_a_dataset_is_measured_solved_and_judged_by_its_truth(
    of_data: Path, measured: Measurements, rendered_sequence: Path
) -> None:
    found = read_comparison(of_data / "compare.json")
    assert found.problems[0].truth and found.problems[0].frames == RENDERED_FRAMES
    (ours, odometry) = found.rows
    assert ours.status == "ok" and ours.errors is not None and odometry.errors is not None
    assert ours.errors.attitude_deg < 1.0
    truth = truth_of_frames(rendered_sequence, measured[0].timestamps_ns)
    assert truth is not None and ours.k1 is not None
    assert ours.errors.k1 == pytest.approx(ours.k1 - truth.k1, abs=1e-12)
    page = (of_data / "compare.html").read_text()
    assert "Estimate minus truth" in page and f">{ours.errors.k1:+.4f}<" in page
    header, first = (line.split(",") for line in (of_data / "compare.csv").read_text().splitlines()[:2])
    assert float(first[header.index("error_position_mm")]) == ours.errors.position_mm


def test_a_run_is_judged_by_the_truth_of_its_sequence_which_reaches_no_solver(
    of_data: Path, measured: Measurements, rendered_sequence: Path, config: Path, tmp_path: Path
) -> None:
    run = tmp_path / "sequence"
    run.mkdir()
    tracks, links = measured
    write_measurements(tracks, run / "measurements.npz", links)
    command, known = ["compare", str(config), "--run", str(run)], read_comparison(of_data / "compare.json")
    for name, more in (("judged", ["--truth", str(rendered_sequence)]), ("blind", [])):
        out = tmp_path / name
        assert main([*command, "-o", str(out), *OPTIONS, *more]) == 0
        found = read_comparison(out / "compare.json")
        assert found.problems[0].truth == (name == "judged")
        for row, same in zip(found.rows, known.rows, strict=True):
            for field in ("solver", "status", "cost", "k1", "k2", "iterations"):
                assert getattr(row, field) == getattr(same, field)
            assert row.errors == (same.errors if name == "judged" else None)
        page = (out / "compare.html").read_text()
        assert ("Estimate minus truth" in page) == (name == "judged")
    late = np.array([10**18, 10**18 + 10**9], dtype=np.int64)
    with pytest.raises(InputError, match="does not cover the run"):
        truth_of_frames(rendered_sequence, late)
