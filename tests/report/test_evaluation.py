"""A run whose estimate is the truth, or off by a known amount, against a sequence with another frame G."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polhode.backend.problem.inertia import FORMS, inertia_from_second_moments
from polhode.cli.main import main
from polhode.config import Config
from polhode.geometry.lie import exp_so3
from polhode.records.estimate import MotionEstimate
from polhode.report import write_evaluation
from polhode.report.evaluation import evaluate, format_table, inertia_parameter_error
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_schema import Intervals
from polhode.runtime.errors import InputError
from tests.pipeline.conftest import Example
from tests.pipeline.example_sequence import write_sequence
from tests.pipeline.stored_run import write_run


@pytest.fixture(scope="module")
def sequence(example: Example, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sequence(example, tmp_path_factory.mktemp("sequence"))


def write_example(
    example: Example, estimate: MotionEstimate, folder: Path, intervals: Intervals | None = None
) -> Path:
    folder.mkdir()
    write_run(
        folder,
        config=Config(),
        tracks=example.tracks,
        estimate=estimate,
        surface=example.surface,
        timing_s={},
        intervals=intervals,
    )
    return folder


def test_the_truth_scores_zero_in_another_frame_G(example: Example, sequence: Path, tmp_path: Path) -> None:
    run = write_example(example, example.estimate, tmp_path / "run")
    metrics = evaluate(run, sequence)
    assert metrics["rmse_position_m"] < 1e-12
    assert metrics["attitude_error_deg"]["max"] < 1e-5
    assert metrics["attitude_error_with_axes_deg"]["max"] < 1e-5
    assert metrics["error_com_mm"] < 1e-9
    assert abs(metrics["error_k1"]) < 1e-12
    assert all(value < 1e-6 for value in metrics["nees"].values())
    assert {"momentum", "momentum_size", "spin"} < set(metrics["nees"])
    assert all(abs(value) < 1e-5 for value in metrics["rotation"].values())
    assert all(value < 1e-4 for value in metrics["prediction_error_deg"].values())
    assert all(value < 1e-8 for value in metrics["prediction_error_m"].values())
    assert metrics["mesh"]["chamfer_mm"] < 2e-3
    assert metrics["mesh"]["completeness_3mm"] == 1.0
    assert metrics["mesh"]["within_one_sigma"] == metrics["mesh"]["within_three_sigma"] == 1.0
    assert metrics["mesh"]["patches_within_one_sigma"] is None
    write_evaluation(run, metrics)
    stored = json.loads((run / "metrics.json").read_text())
    assert stored.pop("summary_sha256") == hashlib.sha256((run / "summary.json").read_bytes()).hexdigest()
    assert stored == metrics
    assert metrics["coverage_3sigma_constants"] == {"inertia": 1.0, "com": 1.0, "axes": 1.0}
    table = format_table(metrics)
    assert "rmse_position_m" in table and "expected" in table
    units = {"rmse_velocity_m_s": "m/s", "prediction_error_deg 10": "deg", "mesh completeness_3mm": ""}
    assert all(re.search(rf" {name} .*\d │ {unit} +│", table) for name, unit in units.items())
    assert re.search(
        r" attitude_error_deg max .*\n.*after the constant rotation of the axes is removed ", table
    )
    assert re.search(
        r" attitude_error_with_axes_deg max .*\n.*of the run's own axes, after half_turn ", table
    )
    (line,) = [line for line in table.splitlines() if "nees inertia" in line]
    assert "0.83 to 12.8" in line


def test_an_offset_centre_of_mass_shows_in_com_and_position_not_in_the_mesh(
    example: Example, sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true = example.estimate
    offset_P = np.array([1e-3, 2e-3, -2e-3])
    wrong = replace(
        true,
        r_N=true.r_N + true.R_NP @ offset_P,
        mass=replace(true.mass, com_G=true.mass.com_G + true.mass.R_GP @ offset_P),
    )
    run = write_example(example, wrong, tmp_path / "run")
    metrics = evaluate(run, sequence)
    assert "truth_in_interval" not in metrics
    assert metrics["error_com_mm"] == pytest.approx(3.0, rel=1e-6)
    assert metrics["rmse_position_m"] == pytest.approx(3e-3, rel=1e-6)
    assert metrics["nees"]["com"] == pytest.approx(9e-6 / 1e-7, rel=1e-6)
    assert metrics["mesh"]["chamfer_mm"] < 2e-3
    # a run without a mesh is evaluated all the same, and written only with its report
    (run / "mesh.ply").unlink()
    (run / "pictures").mkdir(exist_ok=True)
    (run / "pictures" / "captions.json").write_text('{"00.png": "hal')
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert main(["evaluate", str(run), str(sequence)]) == 2
    printed = capsys.readouterr()
    assert "captions.json" in printed.err and "rmse" not in printed.out
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    (run / "pictures" / "captions.json").write_text("{}")
    (run / "metrics.json").write_text('{"rmse')
    assert main(["evaluate", str(run), str(sequence)]) == 0
    printed = capsys.readouterr()
    assert "rmse_position_m" in printed.out and "not available" in printed.out
    assert "rmse_position_m" in (run / "metrics.json").read_text()
    assert "Against the truth" in (run / "report.html").read_text()
    with pytest.raises(InputError, match="target0 is missing"):
        evaluate(run, tmp_path)


def test_of_each_interval_is_said_whether_the_truth_is_inside(
    undetermined: Example, sequence: Path, tmp_path: Path
) -> None:
    mass = undetermined.estimate.mass
    box = (tuple(mass.com_G - 0.01), tuple(mass.com_G + 0.01))
    around, beside = (mass.k1 - 0.1, mass.k1 + 0.1), (mass.k2 + 0.1, mass.k2 + 0.2)
    # the estimate is the truth here: no shift
    shift = (None, (0.002, 0.05), (-0.01, 0.01))
    given = Intervals(com_G=box, com_shift_P=shift, k1=around, k2=beside)
    run = write_example(undetermined, undetermined.estimate, tmp_path / "run", given)
    metrics = evaluate(run, sequence)
    expected = {"k1": True, "k2": False, "com_y": False, "com_z": True, "com_G": True}
    assert metrics["truth_in_interval"] == expected
    # what is undetermined has no NEES
    assert metrics["nees"]["inertia"] is metrics["nees"]["com"] is metrics["nees"]["attitude"] is None
    assert metrics["coverage_3sigma_constants"]["inertia"] is None
    assert metrics["nees"]["angular_velocity"] < 1e-6
    line = next(each for each in format_table(metrics).splitlines() if "truth_in_interval k2" in each)
    assert re.findall(r"True|False", line) == ["False", "True"]


@pytest.mark.parametrize("name", FORMS)
def test_inertia_error_is_the_step_in_the_solvers_parameters(name: str) -> None:
    form = FORMS[name]
    J = np.diag([1.3, 1.0, 0.8])
    xi, R_ref = form.coordinates(0.5 * np.trace(J) * np.eye(3) - J)
    step = np.array([0.01, -0.02, 0.015, 0.005, -0.01])
    J_true = 7.0 * inertia_from_second_moments(form.second_moments(xi - step, R_ref))
    np.testing.assert_allclose(inertia_parameter_error(J, J_true, form), step, atol=1e-9)


def test_errors_of_momentum_and_spin_are_angles_and_a_share_with_their_nees(
    example: Example, sequence: Path, tmp_path: Path
) -> None:
    true = example.estimate
    turn = exp_so3(np.array([0.0, 0.02, 0.0]))
    run = write_example(example, replace(true, R_NP=turn @ true.R_NP, w_P=1.01 * true.w_P), tmp_path / "run")
    metrics, rotation = evaluate(run, sequence), read_summary(run).rotation
    assert rotation is not None and rotation.sigma_momentum_rad_s is not None
    h_N = np.array(rotation.momentum_N.unit)
    # a turn by 0.02 about y moves what is not along y
    expected = np.rad2deg(2.0 * np.arcsin(np.sin(0.01) * np.sqrt(1.0 - h_N[1] ** 2)))
    assert metrics["rotation"]["momentum_direction_deg"] == pytest.approx(expected, rel=1e-6)
    assert metrics["rotation"]["momentum_size_percent"] == pytest.approx(1.0, rel=1e-6)
    off = 0.01 / 1.01 * rotation.momentum_rad_s / rotation.sigma_momentum_rad_s
    assert metrics["nees"]["momentum_size"] == pytest.approx(off**2, rel=1e-6)
    across = turn.T @ h_N - h_N
    by_inverse = across @ np.linalg.pinv(np.array(rotation.momentum_N.cov)) @ across
    assert metrics["nees"]["momentum"] == pytest.approx(by_inverse, rel=1e-3)
