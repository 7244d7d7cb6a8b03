"""The library: a finished run as an object, and what its functions share with the command line."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import polhode
from polhode.api import configuration
from polhode.cli.main import main
from polhode.config import Config
from polhode.geometry.lie import inverse_pose, transform_points
from polhode.planning.plan import final_estimate
from polhode.planning.predict import predict_run
from polhode.planning.prediction import nominal_motion
from polhode.records.estimate import Landmarks
from polhode.run_directory.archives import write_covariance, write_measurements
from polhode.run_directory.point_cloud_file import write_landmarks
from polhode.run_directory.summary_schema import CheckVerdict, Verdict
from polhode.runtime.errors import InputError
from tests.pipeline.conftest import Example, write_example

POINTS_G = np.array([[0.06, 0.0, 0.1], [0.0, 0.1, 0.0], [0.0, 0.0, 0.0]])


@pytest.fixture
def stored(example: Example, tmp_path: Path) -> polhode.Run:
    (tmp_path / "run").mkdir()
    write_example(tmp_path / "run", example)
    return polhode.load(tmp_path / "run")


def test_a_stored_run_is_what_was_estimated(stored: polhode.Run, example: Example) -> None:
    estimate, mass = example.estimate, stored.mass
    assert stored.status == "ok" and stored.verdict is not None and stored.verdict.status == "ok"
    np.testing.assert_array_equal(stored.trajectory.r_N, estimate.r_N)
    np.testing.assert_allclose(stored.covariance, estimate.covariance)
    np.testing.assert_allclose(stored.X_NG, estimate.X_NG, atol=1e-12)
    np.testing.assert_allclose(stored.landmarks.p_G, estimate.landmarks.p_G, atol=1e-6)
    assert len(stored.mesh.faces) == len(example.surface.mesh.faces)
    assert len(stored.measurements.frame) == len(example.tracks.frame)
    np.testing.assert_allclose(mass.k, [estimate.mass.k1, estimate.mass.k2])
    np.testing.assert_allclose(mass.cov_com_G, estimate.mass.cov_com_G)
    np.testing.assert_allclose(mass.J_G, estimate.mass.J_G)
    assert mass.identifiable.com and mass.mass_kg is None
    np.testing.assert_array_equal(stored.links.i, example.relative.i)
    np.testing.assert_array_equal(stored.links.X_RiRj, example.relative.X_RiRj)
    np.testing.assert_array_equal(stored.covariance_of_marks, estimate.covariance_of_marks)
    ratio = f"k1 {mass.k[0]:.4f} +- {np.sqrt(mass.cov_k[0, 0]):.4f}"
    assert repr(stored).startswith(f"<polhode.Run {stored.folder}: ok, 23 of 24 frames, {ratio}")


def test_what_is_undetermined_has_infinite_variance(undetermined: Example, tmp_path: Path) -> None:
    write_example(tmp_path, undetermined)
    run = polhode.load(tmp_path)
    assert np.isinf(np.diagonal(run.mass.cov_k)).all() and not run.mass.identifiable.com
    np.testing.assert_array_equal(np.isinf(np.diagonal(run.mass.cov_com_G)), [False, True, False])
    assert "k1 not determined, k2 not determined" in repr(run)


def test_files_of_other_versions_runs_and_failures_are_refused(stored: polhode.Run, example: Example) -> None:
    estimate, folder = example.estimate, stored.folder
    write_covariance(replace(estimate, covariance_of_marks=None), folder / "covariance.npz")
    with pytest.raises(InputError, match=r"an earlier version wrote it.* run it again, or .*predict\(0.0\)"):
        stored.covariance_of_marks  # noqa: B018
    fewer = Landmarks(*(part[1:] for part in vars(estimate.landmarks).values()))
    write_landmarks(fewer, folder / "landmarks.ply")
    with pytest.raises(InputError, match=r"has 149 points, but 150 landmarks of measurements.npz were kept"):
        stored.landmark_numbers  # noqa: B018
    write_measurements(example.tracks, folder / "measurements.npz")
    names = stored.to_pandas("observations").columns
    assert "u_px" in names and not any(name.startswith("residual") for name in names)
    for part, words in (
        ("residuals", "before it had an estimate"),
        ("links", "before it had matched frames"),
    ):
        with pytest.raises(InputError, match=words):
            getattr(stored, part)


def pose_at(run: polhode.Run, time_s: float) -> np.ndarray:
    """X_NG (4, 4) by the predicted centre of mass and axes."""
    motion, mass, X_NG = run.predict(time_s), run.mass, np.eye(4)
    X_NG[:3, :3] = motion.R_NP[0] @ mass.R_GP.T
    X_NG[:3, 3] = motion.r_N[0] - X_NG[:3, :3] @ mass.com_G
    return X_NG


def test_a_prediction_is_that_of_the_command_with_poses_and_places_of_points(stored: polhode.Run) -> None:
    of_command = predict_run(stored.folder, 2.0, step_s=0.5)
    motion = stored.predict(of_command.time_s)
    for name in ("r_N", "covariance", "timestamps_ns"):
        np.testing.assert_array_equal(getattr(motion, name), getattr(of_command, name))
    np.testing.assert_allclose(stored.predict(0.0).X_NG[0], stored.X_NG[-1], atol=1e-9)
    estimate, _ = final_estimate(stored.folder)
    np.testing.assert_allclose(motion.X_NG, nominal_motion(estimate, motion.time_s).X_NG, atol=1e-8)
    X_NG = pose_at(stored, float(motion.time_s[2]))
    np.testing.assert_allclose(motion.X_NG[2], X_NG, atol=1e-12)
    np.testing.assert_allclose(motion.points_N(stored.mass.com_G), motion.r_N, atol=1e-12)
    places_N = motion.points_N(POINTS_G)
    np.testing.assert_allclose(places_N[:, 1], motion.points_N(POINTS_G[1]), atol=0.0)
    np.testing.assert_allclose(places_N[2], transform_points(X_NG, POINTS_G), atol=1e-12)


def test_velocities_are_those_of_the_moving_body_at_one_time_or_many(stored: polhode.Run) -> None:
    step_s, times = 1e-3, np.linspace(0.0, 60.0, 4)
    before, after = (transform_points(pose_at(stored, t), POINTS_G) for t in (1.0 - step_s, 1.0 + step_s))
    found = stored.points_velocity(POINTS_G, 1.0)
    np.testing.assert_allclose(found, (after - before) / (2.0 * step_s), atol=1e-6)
    velocity = stored.points_velocity(POINTS_G, times)
    covariance = stored.points_velocity_covariance(POINTS_G, times)
    for k, time_s in enumerate(times):
        np.testing.assert_allclose(velocity[k], stored.points_velocity(POINTS_G, time_s), atol=1e-8)
        alone = stored.points_velocity_covariance(POINTS_G, time_s)
        np.testing.assert_allclose(covariance[k], alone, rtol=1e-4, atol=1e-12)


def test_functions_of_points_have_the_same_shapes(stored: polhode.Run) -> None:
    times = np.array([0.0, 0.5])
    for of_points, time in product((POINTS_G[:2], POINTS_G[0]), (times, 0.5)):
        shape = (*np.shape(time), *of_points.shape)
        for value in (stored.points_N, stored.points_velocity):
            assert value(of_points, time).shape == shape
        for covariance in (stored.points_covariance, stored.points_velocity_covariance):
            assert covariance(of_points, time).shape == (*shape, 3)
    motion = stored.predict(times)
    np.testing.assert_array_equal(stored.points_N(POINTS_G, times), motion.points_N(POINTS_G))
    of_one = motion.points_covariance(POINTS_G[1])
    np.testing.assert_array_equal(stored.points_covariance(POINTS_G, times)[:, 1], of_one)


def test_points_and_times_that_do_not_fit_are_one_line(stored: polhode.Run) -> None:
    point = [1.0, 2.0, 3.0]
    wrong: tuple[tuple[object, object, str], ...] = (
        ([1.0, 2.0], 0.0, r"points of shape \(2,\): give finite coordinates \(n, 3\)"),
        ([[point]], 0.0, r"points of shape \(1, 1, 3\)"),
        ([[1.0, 2.0, np.nan]], 0.0, "finite coordinates"),
        ("here", 0.0, "points: give numbers"),
        (point, [1.0, 0.5], "times: give increasing seconds"),
        (point, [-1.0, 0.5], "none below 0"),
        (point, [[0.0, 1.0]], r"times of shape \(1, 2\)"),
        (point, [], r"times of shape \(0,\)"),
        (point, "soon", "times: give numbers"),
        (point, [0.0, 1e12], r"^time_s=1e\+12: .* revolutions"),
    )
    for name in ("points_N", "points_covariance", "points_velocity", "points_velocity_covariance"):
        for points, times, words in wrong:
            with pytest.raises(InputError, match=words) as error:
                getattr(stored, name)(points, times)
            assert "\n" not in str(error.value)
    for refused in (-1.0, [1.0, 0.5], [[1.0]], [np.nan], []):
        with pytest.raises(InputError, match="times"):
            stored.predict(refused)


@pytest.mark.usefixtures("coarse_keep_out")
def test_keep_out_observability_and_exports_follow_from_the_object(
    stored: polhode.Run, tmp_path: Path
) -> None:
    swept = stored.keep_out(2.0, 0.97, members=100).swept
    now = transform_points(stored.X_NG[-1], np.asarray(stored.mesh.vertices))
    assert (swept.signed_distance(now) < 0.0).all()
    assert (swept.signed_distance(now + np.array([3.0, 0.0, 0.0])) > 2.0).all()
    assessed = stored.observability(sigma_px=0.5)
    assert assessed.sigma.shape == (24, 6) and (assessed.sigma[np.isfinite(assessed.sigma)] > 0.0).all()
    files = stored.export("tum", tmp_path / "motion.tum", horizon=2.0)
    assert files == [tmp_path / "motion.tum"] and files[0].read_text().startswith("#")


def test_errors_name_the_arguments_of_python_and_are_those_of_the_command(
    stored: polhode.Run,
    small_sequence: Path,
    rendered_sequence: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    place, tum = tmp_path / "target.urdf", tmp_path / "m.tum"
    wrong: dict[str, Callable[[], object]] = {
        r"^to 'urdff': unknown; did you mean urdf\? give one of glb ply .* json$": lambda: stored.export(
            "urdff",  # type: ignore[arg-type]
            place,
        ),
        r"^output .*target.urdf: .urdf is .* give target.glb, or to='urdf'$": lambda: stored.export(
            "glb", place
        ),
        r"^export has no option 'horizn'; did you mean horizon\? options: frame, unit, .*": lambda: (
            stored.export("tum", tum, horizn=2.0)
        ),
        r"^horizon=0: give the seconds": lambda: stored.export("tum", tum, horizon=0.0),
        r"^frame='G': an OEM is the path": lambda: stored.export("oem", tmp_path / "m.oem", frame="G"),
        r"^confidence=2: give a share": lambda: stored.keep_out(2.0, 2.0),
        r"^horizon_s=-1: give the seconds": lambda: stored.keep_out(-1.0),
        r"^members=4: ": lambda: stored.keep_out(2.0, 0.97, members=4),
        r"^edges=0: give a number": lambda: stored.observability(edges=0),
        r"^frame='N': give trajectory FILE": lambda: stored.observability(frame="N"),
        r"replace it with overwrite=True": lambda: polhode.run(small_sequence, stored.folder, progress=False),
        "missing is not a folder": lambda: polhode.run(tmp_path / "missing", progress=False),
        "no 'scene'": lambda: polhode.simulate(None, tmp_path / "seq", progress=False),
        "no table 'forces'; there are trajectory, online": lambda: stored.to_pandas(
            "forces"  # type: ignore[arg-type]
        ),
        r"trajectory_online.csv": lambda: stored.to_pandas("online"),
    }
    for message, call in wrong.items():
        with pytest.raises(InputError, match=message):
            call()
    assert not list(tmp_path.glob("*.*"))
    with pytest.raises(InputError) as caught:
        polhode.evaluate(stored, rendered_sequence)
    assert main(["evaluate", str(stored.folder), str(rendered_sequence)]) == 2
    assert capsys.readouterr().err == f"polhode: error: {caught.value}\n"


def test_tables_have_the_numbers_of_the_records(stored: polhode.Run) -> None:
    landmarks, observations, checks = (
        stored.to_pandas(name) for name in ("landmarks", "observations", "checks")
    )
    np.testing.assert_array_equal(landmarks[["x", "y", "z"]], stored.landmarks.p_G)
    seen = observations.groupby("landmark").size()
    np.testing.assert_array_equal(landmarks.set_index("landmark")["observations"], seen)
    names = ["u_px", "v_px", "disparity_px"]
    np.testing.assert_array_equal(observations[names], stored.measurements.uvd_px)
    residuals = observations[[f"residual_{name}" for name in names]]
    np.testing.assert_array_equal(residuals, stored.residuals.residuals_px)
    stamps = stored.measurements.timestamps_ns[observations["frame"]]
    np.testing.assert_array_equal(observations["timestamp_ns"], stamps)
    assert stored.verdict is not None
    assert list(checks["name"]) == [check.name for check in stored.verdict.checks]
    of_file = pd.read_csv(stored.folder / "trajectory.csv")
    pd.testing.assert_frame_equal(stored.to_pandas(), of_file, rtol=1e-12)


def test_measurements_and_map_give_the_residuals(finished: Path) -> None:
    """Whoever starts from the measurements finds the landmark of each in the map."""
    run = polhode.load(finished)
    tracks, residuals, numbers = run.measurements, run.residuals, run.landmark_numbers
    inlier = residuals.inlier_weight > 0.0
    assert 0 < len(numbers) == len(run.landmarks.p_G)
    frame, row = tracks.frame[inlier], np.searchsorted(numbers, tracks.landmark[inlier])
    X_RG = (inverse_pose(tracks.X_NR) @ run.X_NG)[frame]
    p_R = np.einsum("nij,nj->ni", X_RG[:, :3, :3], run.landmarks.p_G[row]) + X_RG[:, :3, 3]
    expected = tracks.uvd_px[inlier] - tracks.rig.project(p_R)
    np.testing.assert_allclose(expected, residuals.residuals_px[inlier], atol=1e-6)


def test_a_run_says_what_was_found_in_a_line(stored: polhode.Run) -> None:
    mass = stored.mass
    ratio = f"k1 {mass.k[0]:.4f} +- {np.sqrt(mass.cov_k[0, 0]):.4f}"
    assert repr(stored).startswith(f"<polhode.Run {stored.folder}: ok, 23 of 24 frames, {ratio}")


def test_the_verdict_is_a_few_lines_that_name_what_does_not_hold(stored: polhode.Run) -> None:
    checks = (
        CheckVerdict(name="residuals", value=1.0, expected=(0.0, 2.0), holds=True),
        CheckVerdict(name="prediction", value=5.0, expected=(0.0, 3.0), holds=False),
        CheckVerdict(name="images", value=7.0, expected=(0.0, None), holds=None),
        CheckVerdict(name="mirror twin", value=None, expected=(0.0, 3.0), holds=None),
    )
    verdict = Verdict(status="degraded", reasons=("<script>alert(1)</script>",), checks=checks)
    assert repr(verdict).splitlines() == [
        "degraded: 1 of 2 checks hold",
        "  reason: <script>alert(1)</script>",
        "  does not hold: prediction",
        "  not possible with these data: mirror twin",
    ]
    assert repr(verdict) == str(verdict)
    assert str(stored.verdict).startswith("ok: ") and len(str(stored.verdict)) < 1000


def test_a_configuration_is_a_file_a_dictionary_or_itself(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("seed: 5\n")
    assert configuration(tmp_path / "c.yaml").seed == 5 == configuration({"seed": 5}).seed
    assert configuration(None) == Config() == configuration(Config())
    nested = configuration({"backend": {"inertia": "ratios_axes"}})
    assert nested == configuration({"backend.inertia": "ratios_axes"}) != Config()
    for settings, nearest in (
        ({"bakend.inertia": "ratios_axes"}, "backend"),
        ({"backend": {"inertiaa": "ratios_axes"}}, "inertia"),
        ({"backend.voxel_m": 3.0}, "mapping.voxel_mm"),
    ):
        with pytest.raises(
            InputError, match=rf"^settings: unknown key .* did you mean {nearest}\? valid keys: "
        ):
            configuration(settings)


SCRIPT = """
import sys

import polhode

print("begins")
try:
    print("ends", polhode.run({folder!r}, progress=False, config={{"runtime.workers": 2}}).status)
except polhode.runtime.errors.RunFailure as failure:
    print(failure)
assert not {{"dask", "distributed", "pyarrow"}} & set(sys.modules)
"""


def test_a_run_without_an_answer_raises_leaves_no_folder_and_a_script_needs_no_guard(
    small_sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The processes of a script would otherwise begin it again."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(folder=str(small_sequence)))
    words = [sys.executable, str(script)]
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
    begins, said = done.stdout.splitlines()
    assert begins == "begins" and re.search(r"stereo features on the target.*give output to keep it", said)
    assert not list(tmp_path.glob("polhode-*"))
