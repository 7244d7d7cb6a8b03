"""Faults of what was measured, by what the command says: its exit code, its warnings, the files it leaves."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.frontend.tracks.tracks import to_tracks
from polhode.records.tracks import StereoTracks
from polhode.run_directory.archives import read_measurements
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.simulation.monte_carlo import SyntheticScene
from tests.pipeline.synthetic_front_end import FRAMES, NO_WINDOW, SCENE, Outcome

STOPPED_EARLY = {"summary.json", "measurements.npz", "report.html", "config.yaml", "log.txt"}
FOUND = STOPPED_EARLY | {"trajectory.csv", "covariance.npz", "landmarks.ply"}
WINDOW = ("--backend.window.solver", "gauss_newton")
"""It ends where IPOPT does (tests/backend/window/test_ipopt.py), which fast rotations keep busy for long."""
Run = Callable[..., Outcome]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    return partial(Outcome, tmp_path, monkeypatch, capfd)


def assert_done(outcome: Outcome) -> None:
    """Exit code 0, a complete folder, the report's path at the end of the last line."""
    assert (outcome.code, outcome.summary["status"]) == (0, "ok") and outcome.files >= FOUND
    assert outcome.out[-1].endswith("report.html")
    assert not [line for line in outcome.errors if line.startswith("polhode: error")]


def assert_failed(outcome: Outcome, files: set[str]) -> str:
    """Exit code 1, a folder with what was found, one line that names its report and the reason; that line."""
    assert (outcome.code, outcome.summary["status"]) == (1, "failed") and outcome.files >= files
    (said,) = [line for line in outcome.errors if line.startswith("polhode: error")]
    assert outcome.warnings[0] in said and said.endswith(str(outcome.folder / "report.html"))
    return said


def test_a_window_longer_than_the_sequence_and_a_frame_without_measurements_are_warnings(run: Run) -> None:
    outcome = run(replace(SCENE, frames=8, dropped=(4,)), *WINDOW)
    assert_done(outcome)
    assert outcome.says("1 frame without measurements was bridged by the dynamics")
    assert (outcome.summary["frames"], outcome.summary["frames_used"]) == (8, 7)
    assert outcome.says("the sliding window of 12 frames is longer than the sequence of 8")
    for name in ("trajectory.csv", "trajectory_online.csv"):
        assert len(read_trajectory(outcome.folder / name).timestamps_ns) == 8


def test_a_landmark_seen_once_is_mapped_with_a_warning(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def with_singles(*arguments: Any, **more: Any) -> StereoTracks:
        tracks = to_tracks(*arguments, **more)
        _, first = np.unique(tracks.landmark, return_index=True)
        kept = (tracks.landmark >= 3) | np.isin(np.arange(len(tracks.landmark)), first)
        return replace(
            tracks, **{n: getattr(tracks, n)[kept] for n in ("frame", "landmark", "uvd_px", "sigma_px")}
        )

    monkeypatch.setattr("polhode.pipeline.context.to_tracks", with_singles)
    outcome = run(SCENE, *NO_WINDOW)
    assert_done(outcome)
    assert outcome.says("3 landmarks were seen only once: each is where that one stereo pair puts it")
    assert np.sum(np.bincount(read_measurements(outcome.folder).landmark) == 1) == 3


def test_a_target_at_rest_claims_nothing_with_a_warning(run: Run) -> None:
    outcome = run(replace(SCENE, w_G=(0.0, 0.0, 0.0), torque_psd=1e-12), *NO_WINDOW)
    assert_done(outcome)
    assert outcome.says("the motion does not determine: com_x, com_y, com_z, k1, k2, axes_x, axes_y, axes_z")
    assert not any(outcome.summary["identifiable"].values())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--backend.max-iterations", "1", *WINDOW), "limit of iterations (backend.max_iterations)"),
        ((*NO_WINDOW, "--backend.max-seconds", "1e-6"), "limit of time (backend.max_seconds)"),
        (
            (*NO_WINDOW, "--backend.max-seconds", "1e-6", "--backend.solver", "gauss_newton"),
            "(backend.max_seconds)",
        ),
    ],
    ids=["iterations", "time", "time of the second solver"],
)
def test_a_limit_without_convergence_fails_with_the_best_motion(
    run: Run, options: tuple[str, ...], words: str
) -> None:
    # The search for the level of the disturbances would end at the optimum already.
    outcome = run(SCENE, "--backend.process-noise", "given", *options)
    line = assert_failed(outcome, FOUND)
    assert "the solver stopped before convergence" in line and words in line
    assert outcome.summary["solver"]["converged"] is False and outcome.summary["inertia"] is not None
    assert len(read_trajectory(outcome.folder).timestamps_ns) == FRAMES


def test_nothing_but_outliers_or_no_links_fail_and_leave_the_measurements(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = run(replace(SCENE, outliers=1.0))
    assert "no consistent motion" in assert_failed(outcome, STOPPED_EARLY)
    assert outcome.summary["frames"] == FRAMES

    def scattered(*arguments: Any, **more: Any) -> StereoTracks:
        """Linked frames, in which no observation is where a motion puts it."""
        tracks = to_tracks(*arguments, **more)
        return replace(tracks, uvd_px=np.random.default_rng(0).uniform(20.0, 400.0, tracks.uvd_px.shape))

    monkeypatch.setattr("polhode.pipeline.context.to_tracks", scattered)
    outcome = run(SCENE)
    assert "no consistent motion" in assert_failed(outcome, STOPPED_EARLY)
    assert outcome.summary["frames"] == FRAMES
    assert len(read_measurements(outcome.folder).frame) == outcome.summary["observations"] > 0


def fast(turn_deg: float, axis: tuple[float, float, float], landmarks: int) -> SyntheticScene:
    """A tumble by about this turn between frames."""
    w_G = np.deg2rad(turn_deg) / SCENE.dt_s * np.array(axis) / np.linalg.norm(axis)
    return replace(SCENE, landmarks=landmarks, w_G=tuple(w_G.tolist()))


@pytest.mark.parametrize(("turn_deg", "seed", "landmarks"), [(190.0, 190, 80), (220.0, 5, 80)])
def test_about_half_a_turn_between_frames_is_said_whichever_way_it_ends(
    run: Run, turn_deg: float, seed: int, landmarks: int
) -> None:
    outcome = run(fast(turn_deg, (0.5, 0.7, 0.5), landmarks), *NO_WINDOW, seed=seed)
    if outcome.code == 0:
        assert outcome.says("direction of rotation")
    else:
        assert "by more than half a revolution between pairs" in assert_failed(outcome, STOPPED_EARLY)


def test_a_motion_a_revolution_off_is_never_believed(run: Run) -> None:
    """Euler's equation with another inertia may fit too: nothing that hangs on it counts as determined."""
    outcome = run(replace(fast(260.0, (0.5, 0.7, 0.5), 150), frames=20), *NO_WINDOW)
    if outcome.code == 0:
        known = outcome.summary["identifiable"]
        assert not (known["k1"] or known["k2"] or known["axes"])
        assert outcome.summary["status"] == "degraded" and len(outcome.summary["hypotheses"]) == 2
    else:
        assert_failed(outcome, STOPPED_EARLY)


@pytest.mark.usefixtures("coarse_keep_out")
def test_a_rotation_that_the_images_leave_open_is_two_answers(run: Run) -> None:
    """Equal moments: in summary, predictions, keep-out volume and exports; a stated limit decides."""
    spin = replace(fast(250.0, (0.91, -0.14, 0.39), 120), frames=10, J_G=np.eye(3), torque_psd=1e-12)
    outcome = run(spin, *NO_WINDOW)
    summary, folder = outcome.summary, outcome.folder
    assert (outcome.code, summary["status"]) == (0, "degraded")
    assert summary["verdict"]["reasons"][0].startswith(
        "how far the target rotates between pairs is ambiguous"
    )
    found, w_N = summary["hypotheses"], np.array([0.0, 0.0, np.deg2rad(250.0) / SCENE.dt_s])
    assert sum(each["odds"] for each in found) == pytest.approx(1.0)
    rates = [each["rate_rpm"] * np.pi / 30.0 * np.array(each["direction"]) for each in found]
    slower, faster = sorted(rates, key=np.linalg.norm)
    np.testing.assert_allclose(slower, w_N * (1.0 - 360.0 / 250.0), atol=0.05)
    np.testing.assert_allclose(faster, w_N, atol=0.05)
    table, place = folder.parent / "F.csv", folder.parent / "plan"
    assert main(["predict", str(folder), "--horizon", "1", "-o", str(table)]) == 0
    for file, rate in ((table, rates[0]), (folder.parent / "F_2.csv", rates[1])):
        motion = read_trajectory(file)
        np.testing.assert_allclose(motion.R_NP[-1] @ motion.w_P[-1], rate, atol=0.05)
        assert np.isinf(motion.sigma_w).all()
    few = ("--horizon", "0.5", "--members", "100", "--confidence", "0.97")
    dock = ("--dock-point", "0.1", "0", "0", "--dock-axis", "1", "0", "0")
    assert main(["plan", str(folder), "-o", str(place), *few, *dock]) == 0
    planned = json.loads((place / "planning.json").read_text())
    assert "hold for all of them" in "".join(planned["notes"]) and not (place / "corridor.csv").exists()
    assert planned["corridor"] is planned["approach"] is None
    for name in ("corridor", "approach"):
        assert planned["left_out"][name].startswith("the rotation is ambiguous")
    aem = str(folder.parent / "A.aem")
    assert main(["export", str(folder), "--to", "aem", "-o", aem, "--horizon", "1"]) == 0
    assert "COMMENT hypothesis 1 of 2" in Path(aem).read_text()
    limited = run(spin, *NO_WINDOW, "--backend.max-rpm", "50")
    assert limited.summary["hypotheses"] == [] and limited.summary["status"] == "ok"


@pytest.mark.parametrize(
    ("turn_deg", "J", "axis", "seed"),
    [(300.0, (1.5, 1.2, 0.9), (0.3, 0.9, 0.3), 2), (330.0, (1.8, 1.3, 0.7), (0.1, 1.0, 0.3), 2)],
)
def test_much_more_than_half_a_turn_between_frames_fails_and_names_that_reason(
    run: Run, turn_deg: float, J: tuple[float, ...], axis: tuple[float, float, float], seed: int
) -> None:
    scene = replace(fast(turn_deg, axis, 80), frames=16, J_G=np.diag(J))
    outcome = run(scene, *WINDOW, "--backend.max-iterations", "60", seed=seed)
    assert_failed(outcome, STOPPED_EARLY)
    assert outcome.says("by more than half a revolution between pairs")
