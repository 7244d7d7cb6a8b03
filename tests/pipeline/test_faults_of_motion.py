"""Faults of what was measured, by what the command says: its exit code, its warnings, the files it leaves."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.frontend.tracks.tracks import to_tracks
from polhode.records.tracks import StereoTracks
from polhode.run_directory.archives import read_measurements
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.pipeline.synthetic_front_end import put_in_place

FRAMES = 14
SCENE = SyntheticScene(
    frames=FRAMES, landmarks=120, detection=0.7, sigma_uv_px=0.3, sigma_d_px=0.3,
    J_G=np.diag([1.5, 1.2, 0.9]), w_G=(0.2, 0.8, 0.1),
)  # fmt: skip
FOUND = {
    "summary.json",
    "trajectory.csv",
    "covariance.npz",
    "landmarks.ply",
    "measurements.npz",
    "report.html",
}
NO_PICTURES = ("--pictures.animation", "false", "--pictures.views", "false")
"""The sequence on disk shows nothing of the motion."""
NO_WINDOW = ("--backend.window.enabled", "false")
"""What is asked is said of the whole sequence; one case of each goes through the window too."""
WINDOW = ("--backend.window.solver", "gauss_newton")
"""It ends where IPOPT does (tests/backend/window/test_ipopt.py), which fast rotations keep busy for long."""
STOPPED_EARLY = {"summary.json", "measurements.npz", "report.html", "config.yaml", "log.txt"}
Capture = pytest.CaptureFixture[str]


class MotionOutcome:
    """What a run left, and what it said."""

    def __init__(self, code: int, folder: Path, capture: Capture) -> None:
        self.code, self.folder = code, folder
        self.summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
        self.warnings: list[str] = self.summary["warnings"]
        self.files = {path.name for path in folder.iterdir()}
        captured = capture.readouterr()
        self.out, self.errors = captured.out.splitlines(), captured.err.strip().splitlines()

    def says(self, words: str) -> bool:
        return any(words in warning for warning in self.warnings)


Run = Callable[..., MotionOutcome]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Capture) -> Run:
    """``polhode run`` on the measurements of a scene."""

    def execute(scene: SyntheticScene, seed: int, *overrides: str) -> MotionOutcome:
        put_in_place(generate(scene, seed), tmp_path / "sequence", monkeypatch)
        words = [
            "run",
            "configs/default.yaml",
            "--data",
            str(tmp_path / "sequence"),
            "-o",
            str(tmp_path / "run"),
        ]
        code = main([*words, "--runtime.workers", "1", *NO_PICTURES, *WINDOW, *overrides])
        return MotionOutcome(code, tmp_path / "run", capfd)

    return execute


def assert_done(outcome: MotionOutcome) -> None:
    """Exit code 0, a complete folder, the report's path at the end of the last line."""
    assert outcome.code == 0
    assert outcome.summary["status"] == "ok"
    assert outcome.files >= FOUND
    assert outcome.out[-1].endswith("report.html")
    assert not [line for line in outcome.errors if line.startswith("polhode: error")]


def assert_failed(outcome: MotionOutcome, files: set[str]) -> str:
    """Exit code 1, a folder with what was found, one line that names its report and the reason; that line."""
    assert outcome.code == 1
    assert outcome.summary["status"] == "failed"
    assert outcome.files >= files
    said = [line for line in outcome.errors if line.startswith("polhode: error")]
    assert len(said) == 1 and outcome.warnings[0] in said[0]
    assert said[0].endswith(str(outcome.folder / "report.html"))
    return said[0]


def test_a_frame_without_a_measurement_is_bridged_with_a_warning(run: Run) -> None:
    outcome = run(replace(SCENE, dropped=(6,)), 1)
    assert_done(outcome)
    assert outcome.says("1 frame without measurements was bridged by the dynamics")
    assert (outcome.summary["frames"], outcome.summary["frames_used"]) == (FRAMES, FRAMES - 1)
    assert len(read_trajectory(outcome.folder).timestamps_ns) == FRAMES


def test_a_landmark_seen_once_is_mapped_with_a_warning(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def with_singles(*arguments: Any, **more: Any) -> StereoTracks:
        tracks = to_tracks(*arguments, **more)
        _, first = np.unique(tracks.landmark, return_index=True)
        kept = (tracks.landmark >= 3) | np.isin(np.arange(len(tracks.landmark)), first)
        return replace(
            tracks, **{n: getattr(tracks, n)[kept] for n in ("frame", "landmark", "uvd_px", "sigma_px")}
        )

    monkeypatch.setattr("polhode.pipeline.context.to_tracks", with_singles)
    outcome = run(SCENE, 1, *NO_WINDOW)
    assert_done(outcome)
    assert outcome.says("3 landmarks were seen only once: each is where that one stereo pair puts it")
    assert np.sum(np.bincount(read_measurements(outcome.folder).landmark) == 1) == 3


def test_a_window_longer_than_the_sequence_smooths_what_there_is_with_a_warning(run: Run) -> None:
    outcome = run(replace(SCENE, frames=8), 1)
    assert_done(outcome)
    assert outcome.says("the sliding window of 12 frames is longer than the sequence of 8")
    assert len(read_trajectory(outcome.folder / "trajectory_online.csv").timestamps_ns) == 8


def test_a_target_at_rest_claims_nothing_with_a_warning(run: Run) -> None:
    outcome = run(replace(SCENE, w_G=(0.0, 0.0, 0.0), torque_psd=1e-12), 1)
    assert_done(outcome)
    assert outcome.says("the motion does not determine: com_x, com_y, com_z, k1, k2, axes_x, axes_y, axes_z")
    assert not any(outcome.summary["identifiable"].values())


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("--backend.max-iterations", "1"), "limit of iterations (backend.max_iterations)"),
        ((*NO_WINDOW, "--backend.max-seconds", "1e-6"), "limit of time (backend.max_seconds)"),
        (
            (*NO_WINDOW, "--backend.max-seconds", "1e-6", "--backend.solver", "gauss_newton"),
            "(backend.max_seconds)",
        ),
    ],
    ids=["iterations", "time", "time of the second solver"],
)
def test_a_limit_without_convergence_fails_with_the_best_motion(
    run: Run, overrides: tuple[str, ...], words: str
) -> None:
    # The search for the level of the disturbances would end at the optimum already.
    outcome = run(SCENE, 1, "--backend.process-noise", "given", *overrides)
    line = assert_failed(outcome, FOUND)
    assert "the solver stopped before convergence" in line and words in line
    assert outcome.summary["solver"]["converged"] is False and outcome.summary["inertia"] is not None
    assert len(read_trajectory(outcome.folder).timestamps_ns) == FRAMES


def test_nothing_but_outliers_fails_and_leaves_the_measurements(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frames hang together by their links, but no observation is where a motion puts it."""

    def scattered(*arguments: Any, **more: Any) -> StereoTracks:
        tracks = to_tracks(*arguments, **more)
        return replace(tracks, uvd_px=np.random.default_rng(0).uniform(20.0, 400.0, tracks.uvd_px.shape))

    monkeypatch.setattr("polhode.pipeline.context.to_tracks", scattered)
    outcome = run(SCENE, 1)
    assert "no consistent motion" in assert_failed(outcome, STOPPED_EARLY)
    assert outcome.summary["frames"] == FRAMES and outcome.summary["observations"] > 0
    assert len(read_measurements(outcome.folder).frame) == outcome.summary["observations"]


def test_frames_that_nothing_links_fail_and_leave_what_there_is(run: Run) -> None:
    outcome = run(replace(SCENE, outliers=1.0), 1)
    assert "no consistent motion" in assert_failed(outcome, STOPPED_EARLY)
    assert outcome.summary["frames"] == FRAMES


@pytest.mark.parametrize(
    ("turn_deg", "seed", "landmarks", "options"),
    [(190.0, 5, 150, ()), (190.0, 190, 80, NO_WINDOW), (220.0, 5, 80, NO_WINDOW)],
)
def test_about_half_a_turn_between_frames_is_said_whichever_way_it_ends(
    run: Run, turn_deg: float, seed: int, landmarks: int, options: tuple[str, ...]
) -> None:
    outcome = run(fast(turn_deg, (0.5, 0.7, 0.5), landmarks), seed, *options)
    if outcome.code == 0:
        assert_done(outcome)
        assert outcome.says("direction of rotation")
    else:
        assert "by more than half a revolution between pairs" in assert_failed(outcome, STOPPED_EARLY)


@pytest.mark.parametrize(("turn_deg", "seed", "options"), [(260.0, 1, ()), (280.0, 1, NO_WINDOW)])
def test_a_motion_a_revolution_off_is_never_believed(
    run: Run, turn_deg: float, seed: int, options: tuple[str, ...]
) -> None:
    """Euler's equation with another inertia may fit too: nothing that hangs on it counts as determined."""
    outcome = run(replace(fast(turn_deg, (0.5, 0.7, 0.5), 150), frames=20), seed, *options)
    if outcome.code == 0:
        known = outcome.summary["identifiable"]
        assert not (known["k1"] or known["k2"] or known["axes"])
        assert outcome.says("direction of rotation")
    else:
        assert_failed(outcome, STOPPED_EARLY)


@pytest.mark.parametrize(
    ("turn_deg", "J", "axis", "seed"),
    [
        (300.0, (1.5, 1.2, 0.9), (0.3, 0.9, 0.3), 2),
        (300.0, (1.8, 1.3, 0.7), (0.1, 1.0, 0.3), 1),
        (330.0, (1.5, 1.2, 0.9), (0.3, 0.9, 0.3), 1),
        (330.0, (1.8, 1.3, 0.7), (0.1, 1.0, 0.3), 2),
    ],
)
def test_much_more_than_half_a_turn_between_frames_fails_and_names_that_reason(
    run: Run, turn_deg: float, J: tuple[float, ...], axis: tuple[float, float, float], seed: int
) -> None:
    scene = replace(fast(turn_deg, axis, 80), frames=16, J_G=np.diag(J))
    outcome = run(scene, seed, "--backend.max-iterations", "60")
    assert_failed(outcome, STOPPED_EARLY)
    assert outcome.says("by more than half a revolution between pairs")


def fast(turn_deg: float, axis: tuple[float, float, float], landmarks: int) -> SyntheticScene:
    """A tumble by about this turn between frames."""
    w_G = np.deg2rad(turn_deg) / SCENE.dt_s * np.array(axis) / np.linalg.norm(axis)
    return replace(SCENE, landmarks=landmarks, w_G=tuple(w_G.tolist()))
