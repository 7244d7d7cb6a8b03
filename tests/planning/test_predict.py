"""polhode predict through the real command line: the table, its honesty, its errors."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.problem.inertia import FORMS, inertia_by_parameters, inertia_from_second_moments
from polhode.cli.main import main
from polhode.config import Config
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import exp_so3, log_so3
from polhode.geometry.rigid_body import HALF_TURNS, best_half_turn, propagate
from polhode.geometry.rigid_fit import mean_rotation
from polhode.planning.predict import (
    as_wide_as_bounds,
    prediction_times,
    shown_rows,
    undetermined_components,
)
from polhode.records.estimate import Prediction
from polhode.records.truth import Truth
from polhode.run_directory.trajectory_file import TRAJECTORY_COLUMNS, read_trajectory
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.pipeline.conftest import Example
from tests.pipeline.stored_run import stored

Capture = pytest.CaptureFixture[str]
BOX = np.diag([1.5, 1.2, 0.9])
SEEN, AHEAD = 40, 60
"""Frames in the run, and after it in the truth."""


def simulated_run(folder: Path, w_G: tuple[float, float, float]) -> tuple[Path, Truth]:
    """A run of the back end on the first frames of a free motion, and the truth of all frames."""
    scene = SyntheticScene(
        frames=SEEN + AHEAD, landmarks=250, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.2, J_G=BOX,
        w_G=w_G, accel_psd=1e-10, torque_psd=1e-10, min_inliers=12,
    )  # fmt: skip
    sequence = generate(scene, 0)
    whole, pairs = sequence.tracks, sequence.relative
    use, early = whole.frame < SEEN, pairs.j < SEEN
    _, landmark = np.unique(whole.landmark[use], return_inverse=True)
    rows = {name: getattr(whole, name)[use] for name in ("frame", "uvd_px", "sigma_px")}
    frames = {name: getattr(whole, name)[:SEEN] for name in ("timestamps_ns", "X_NR")}
    tracks = replace(whole, **rows, **frames, landmark=landmark.astype(np.int64))
    names = ("i", "j", "X_RiRj", "inliers")
    relative = replace(pairs, **{name: getattr(pairs, name)[early] for name in names})
    config = Backend(solver="gauss_newton", process_noise="given", accel_psd=1e-10, torque_psd=1e-10)
    initial = initialize_motion(tracks, relative, config)
    estimate = estimate_motion(tracks, initial, config, Silent())
    found = SimpleNamespace(tracks=tracks, estimate=estimate)
    return stored(folder, found, config=Config(backend=config)), sequence.truth


def test_the_table_goes_on_where_the_trajectory_ends(
    bare: Path, example: Example, tmp_path: Path, capsys: Capture
) -> None:
    run, file = bare, tmp_path / "ahead.csv"
    assert main(["predict", str(run), "--horizon", "10", "-o", str(file)]) == 0
    shown = capsys.readouterr().out
    assert all(f"[{unit}]" in shown for unit in ("s", "m", "mm", "mm/s", "deg", "deg/s"))
    assert shown.rstrip().endswith(str(file)) and "of the centre of mass and the principal axes" in shown
    assert file.read_text().splitlines()[0] == ",".join(TRAJECTORY_COLUMNS)
    path, estimate = read_trajectory(file), example.estimate
    np.testing.assert_array_equal(np.diff(path.timestamps_ns), 500_000_000)
    assert path.timestamps_ns[0] == estimate.timestamps_ns[-1] + 500_000_000
    assert path.timestamps_ns[-1] == estimate.timestamps_ns[-1] + 10_000_000_000
    J = np.diag(estimate.mass.moments)
    end = estimate.r_N[-1], estimate.v_N[-1], estimate.R_NP[-1], estimate.w_P[-1]
    r_N, _, R_NP, w_P = propagate(np.linspace(0.0, 10.0, 21), *end, J)
    np.testing.assert_allclose(path.r_N, r_N[1:], atol=1e-9)
    np.testing.assert_allclose(path.R_NP, R_NP[1:], atol=1e-8)
    np.testing.assert_allclose(path.w_P, w_P[1:], atol=1e-8)
    # the level of the example's disturbances is known within half a decade: more than 3.37 sigmas hold 99 %
    position = next(row for row in shown.splitlines() if "position" in row).split()
    shares, size = [float(cell[:-1]) for cell in position if cell.endswith("%")], float(position[-2])
    assert len(shares) == 3 and sum(shares) == pytest.approx(100.0, abs=1.5)
    assert 3.4 < size < 6.0
    # the last row on the screen is that of the file
    last = [row for row in shown.splitlines() if re.match(r"\W*10 ", row)]
    assert len(last) == 2
    for row, values, digits in (
        (last[0], path.r_N[-1], 4),
        (last[0], 1e3 * path.v_N[-1], 3),
        (last[1], path.q_NP_wxyz[-1], 4),
        (last[1], np.rad2deg(path.w_P[-1]), 3),
    ):
        assert " ".join(f"{x:.{digits}f}" for x in values) in row
    assert f"{np.rad2deg(path.sigma_theta[-1].max()):.2g}" in last[1]
    assert np.all(np.isfinite(path.sigma_theta)) and np.all(np.diff(path.sigma_r[:, 0]) > 0.0)


def test_the_archive_holds_full_covariances_and_the_same_bytes_again(
    bare: Path, example: Example, tmp_path: Path
) -> None:
    run = bare
    files = [tmp_path / name for name in ("a.npz", "b.npz")]
    for file in files:
        assert main(["predict", str(run), "--horizon", "3", "--step-s", "0.7", "-o", str(file)]) == 0
    assert files[0].read_bytes() == files[1].read_bytes()
    with np.load(files[0]) as arrays:
        assert arrays["covariance"].shape == arrays["covariance_of_marks"].shape == (5, 12, 12)
        assert arrays["sigma_parts"].shape == (5, 3, 12) and arrays["region_sigmas"].shape == (5, 4)
        assert arrays["parts"].tolist() == ["last state", "inertia", "disturbances"]
        steps = np.diff(arrays["timestamps_ns"], prepend=example.estimate.timestamps_ns[-1])
    np.testing.assert_array_equal(steps, [700_000_000, 700_000_000, 700_000_000, 700_000_000, 200_000_000])


def test_a_tumble_stays_within_three_sigma_for_half_a_minute(tmp_path: Path) -> None:
    run, truth = simulated_run(tmp_path / "run", (0.4, 0.5, 0.45))
    file = tmp_path / "ahead.csv"
    assert main(["predict", str(run), "--horizon", "30", "-o", str(file)]) == 0
    path, later = read_trajectory(file), slice(SEEN, SEEN + AHEAD)
    turn = HALF_TURNS[best_half_turn(path.R_NP, truth.R_NP[later])]
    theta = log_so3(np.swapaxes(path.R_NP, 1, 2) @ (truth.R_NP[later] * turn))
    assert np.mean(np.abs(theta) < 3.0 * path.sigma_theta) > 0.95
    assert np.mean(np.abs(path.r_N - truth.r_N[later]) < 3.0 * path.sigma_r) > 0.95
    assert np.mean(np.abs(path.w_P - truth.w_P[later] * turn) < 3.0 * path.sigma_w) > 0.95
    # honest, and not by being vague
    assert np.rad2deg(path.sigma_theta[-1].max()) < 3.0 and path.sigma_r[-1].max() < 5e-3


def test_an_undetermined_inertia_predicts_the_body_all_the_same(tmp_path: Path, capsys: Capture) -> None:
    run, truth = simulated_run(tmp_path / "run", (0.0, 0.0, 0.8))
    plain, marks = tmp_path / "plain.csv", tmp_path / "marks.csv"
    assert main(["predict", str(run), "--horizon", "30", "-o", str(plain)]) == 0
    printed = capsys.readouterr().out
    assert "does not determine" in printed and "inf in the file" in printed
    assert main(["predict", str(run), "--horizon", "30", "--marks", "-o", str(marks)]) == 0
    assert main(["predict", str(run), "--horizon", "30"]) == 0
    # the one file has none, and then there is no file
    printed = capsys.readouterr().out
    with_marks, without = printed.split("(--marks)")
    assert "inf" not in with_marks and ": the sigmas are those of the body itself" in without
    assert "are inf; --marks gives" in without and "in the file" not in printed
    assert np.all(np.isinf(read_trajectory(plain).sigma_theta))
    path, seen = read_trajectory(marks), read_trajectory(run)
    # the body's attitude: after the constant rotation between the estimated and the true axes
    R_fit = mean_rotation(np.swapaxes(seen.R_NP, 1, 2) @ truth.R_NP[:SEEN])
    theta = log_so3(np.swapaxes(path.R_NP @ R_fit, 1, 2) @ truth.R_NP[SEEN:])
    assert np.rad2deg(np.linalg.norm(theta, axis=1).max()) < 2.0
    sigma = np.sqrt(np.sum(path.sigma_theta**2, axis=1))
    assert np.mean(np.linalg.norm(theta, axis=1) < 3.0 * sigma) > 0.95
    # it was seen for 20 s: that it will never tip over is not certain, for a while it is
    assert np.all(np.isfinite(path.sigma_r)) and np.rad2deg(sigma[20]) < 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--horizon", "0"], "--horizon 0: give the seconds to look ahead"),
        (["--horizon", "nan"], "--horizon nan"),
        (["--horizon", "1e4", "--step-s", "0.01"], "give a larger --step-s"),
        (["--horizon", "1e9"], "revolutions of the target; at most 10000 can be"),
        (["--horizon", "inf"], "--horizon inf"),
        (["--horizon", "1e308"], "--horizon 1e+308"),
        (["--horizon", "1e-308"], "--horizon 1e-308: give seconds from 1e-06"),
        (["--horizon", "10", "--step-s", "1e308"], "--step-s 1e+308"),
        (["--horizon", "10", "--step-s", "inf"], "--step-s inf"),
        (["--horizon", "10", "--step-s", "nan"], "--step-s nan"),
        (["--horizon", "10", "--step-s", "0"], "--step-s 0"),
        (["--horizon", "1e-6", "--step-s", "1e-10"], "--step-s 1e-10: timestamps are whole nanoseconds"),
        ([], "--horizon"),
        (["--horizon", "10", "-o", "/dev/null/all.csv"], "part of this path is a file"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], words: str, bare: Path, capsys: Capture) -> None:
    assert main(["predict", str(bare), *arguments]) == 2
    stderr = capsys.readouterr().err
    assert words in stderr and stderr.count("\n") == 1


def test_a_run_that_failed_or_is_none_is_refused(tmp_path: Path, capsys: Capture) -> None:
    from polhode.run_directory.summary import build_summary, write_summary

    assert main(["predict", str(tmp_path), "--horizon", "10"]) == 2
    assert "give the folder of a run" in capsys.readouterr().err
    write_summary(build_summary(None, None, None, {}, failure="no motion"), tmp_path / "summary.json")
    assert main(["predict", str(tmp_path), "--horizon", "10"]) == 2
    stderr = capsys.readouterr().err
    assert "nothing can be predicted" in stderr and stderr.count("\n") == 1


def test_times_reach_the_horizon_and_no_step_is_nearly_nothing() -> None:
    np.testing.assert_allclose(prediction_times(1.0, 0.4), [0.4, 0.8, 1.0])
    np.testing.assert_allclose(prediction_times(0.3, 0.1), [0.1, 0.2, 0.3])
    np.testing.assert_allclose(prediction_times(0.2, 0.5), [0.2])
    for step_s, horizon_s in ((0.5, 1.0000000004), (1e-9, 1e-6), (1.5e-9, 1e-6), (1e-9, 9.9995e-6)):
        stamps = np.round(prediction_times(horizon_s, step_s) * 1e9)
        assert np.all(np.diff(stamps, prepend=0.0) >= 1.0)
    with pytest.raises(InputError, match="more than 100000 rows"):
        prediction_times(1e6, 0.5)
    # the rows on the screen are at even steps to the horizon
    for count, seconds in ((3, [0.5, 1.0, 1.5]), (1, [0.5]), (61, [5.5, 11.0, 16.5, 22.0, 27.5, 30.5])):
        time_s = 0.5 * np.arange(1, count + 1, dtype=np.float64)
        assert time_s[shown_rows(time_s)].tolist() == seconds


@pytest.mark.parametrize("name", FORMS)
def test_the_inertia_follows_the_solvers_parameters(name: str) -> None:
    form, R = FORMS[name], exp_so3([0.3, -0.2, 0.5])
    J = 3.0 * R @ np.diag([1.3, 1.0, 0.8]) @ R.T
    scaled, slopes = inertia_by_parameters(J, form)
    np.testing.assert_allclose(scaled / scaled[0, 0], J / J[0, 0], atol=1e-12)
    xi, R_ref = form.coordinates(0.5 * np.trace(J) * np.eye(3) - J)
    step = 1e-4 * np.array([1.0, -2.0, 1.5, 0.5, -1.0])
    moved = inertia_from_second_moments(form.second_moments(xi + step, R_ref))
    np.testing.assert_allclose(np.einsum("k,kij->ij", step, slopes), moved - scaled, atol=2e-7)


@pytest.mark.parametrize("rate", [(0.4, 0.0, 0.3), (0.3, 0.3, 0.3)])
def test_a_free_turn_about_an_axis_leaves_both_rates_across_it_open(rate: tuple[float, float, float]) -> None:
    one, covariance = np.zeros((1, 3)), np.eye(12)[None]
    spread = covariance, covariance, np.zeros((1, 3, 12)), np.full((1, 4), 3.37)
    states = Prediction(np.ones(1), one, one, np.eye(3)[None], np.array([rate]), *spread)
    free_z = np.array([False, False, True])
    lost = undetermined_components(np.eye(12), np.zeros(3, dtype=np.bool_), free_z, states)
    assert lost[0].tolist() == [*[False] * 6, False, False, True, True, True, False]


def test_a_centre_of_mass_that_is_not_determined_is_as_uncertain_as_its_bounds() -> None:
    rng = np.random.default_rng(3)
    root, R_GP = 1e-3 * rng.normal(size=(20, 20)), exp_so3(rng.normal(size=3))
    covariance = root @ root.T
    along = np.zeros(20)
    along[17:20] = R_GP[:, 1]
    found = as_wide_as_bounds(covariance, R_GP, (None, (-0.01, 0.05), None))
    # the middle is 20 mm off, and the bounds are 30 mm from it
    assert along @ found @ along == pytest.approx(0.02**2 + 0.03**2 / 3.0)
    # the rest follows as it did: given the centre of mass nothing has changed
    slope = covariance @ along / (along @ covariance @ along)
    np.testing.assert_allclose(found @ along, slope * (along @ found @ along), rtol=1e-9)
    rest = np.eye(20) - np.outer(slope, along)
    np.testing.assert_allclose(rest @ found @ rest.T, rest @ covariance @ rest.T, atol=1e-16)
    for unchanged in ((), (None, (-1e-5, 1e-5), None)):
        np.testing.assert_array_equal(as_wide_as_bounds(covariance, R_GP, unchanged), covariance)
