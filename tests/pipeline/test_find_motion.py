"""What a second method of the front end adds is taken unless it fits worse, and stands in for the first."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.geometry.lie import Array
from polhode.run_directory.archives import read_measurements
from polhode.run_directory.trajectory_file import Trajectory, read_trajectory
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.pipeline.synthetic_front_end import put_in_place

FRAMES = 14
SCENE = SyntheticScene(
    frames=FRAMES, landmarks=120, detection=0.7, sigma_uv_px=0.3, sigma_d_px=0.3,
    accel_psd=0.0, torque_psd=0.0,
    J_G=np.diag([1.5, 1.2, 0.9]), w_G=(0.2, 0.8, 0.1),
)  # fmt: skip
"""Without disturbances the motion of two sequences is one, whatever is measured of it."""
OTHER = replace(SCENE, landmarks=150)
"""What the second method measures."""


NO_PICTURES = ("--pictures.animation", "false", "--pictures.views", "false")
"""The sequence on disk shows nothing of the motion."""
NOTHING_AFTER = ("--backend.window.enabled", "false", "--backend.bounds.intervals", "false")
"""Window and intervals follow when the methods have been chosen."""


@dataclass(frozen=True)
class Outcome:
    """What a run left."""

    code: int
    summary: dict[str, Any]
    trajectory: Trajectory
    observations: int
    log: str


Run = Callable[[SyntheticScene, SyntheticScene | None], Outcome]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """``polhode run`` on what two methods measure of one motion."""

    def execute(first: SyntheticScene, second: SyntheticScene | None) -> Outcome:
        other = None if second is None else generate(second, 1)
        put_in_place(generate(first, 1), tmp_path / "sequence", monkeypatch, other)
        folder = tmp_path / f"run{len(list(tmp_path.iterdir()))}"
        words = ["run", "configs/default.yaml", "--data", str(tmp_path / "sequence"), "-o", str(folder)]
        code = main([*words, "--runtime.workers", "1", *NO_PICTURES, *NOTHING_AFTER])
        return Outcome(
            code,
            json.loads((folder / "summary.json").read_text()),
            read_trajectory(folder),
            len(read_measurements(folder).frame),
            (folder / "log.txt").read_text(),
        )

    return execute


def error_of_w(outcome: Outcome) -> Array:
    truth = generate(SCENE, 1).truth
    return np.asarray(np.linalg.norm(outcome.trajectory.w_P, axis=1) - np.linalg.norm(truth.w_P, axis=1))


def test_frames_that_the_first_method_loses_are_found_by_the_second(run: Run) -> None:
    lost = (5, 6, 7)
    alone = run(replace(SCENE, dropped=lost), None)
    both = run(replace(SCENE, dropped=lost), OTHER)
    assert (alone.summary["frames_used"], both.summary["frames_used"]) == (FRAMES - 3, FRAMES)
    assert both.observations > 1.5 * alone.observations
    assert np.all(np.abs(error_of_w(both)) < 3.0 * np.linalg.norm(both.trajectory.sigma_w, axis=1))


def test_what_fits_worse_is_not_used(run: Run) -> None:
    alone = run(SCENE, None)
    both = run(SCENE, replace(OTHER, sigma_uv_px=1.2))
    assert "the second feature method brings no improvement and is not used" in both.log
    assert both.observations == alone.observations
    np.testing.assert_array_equal(both.trajectory.q_NP_wxyz, alone.trajectory.q_NP_wxyz)


def test_the_second_method_stands_in_where_the_first_finds_no_motion(run: Run) -> None:
    outcome = run(replace(SCENE, outliers=1.0), OTHER)
    assert outcome.code == 0 and outcome.summary["status"] == "ok"
    assert "the second feature method is tried" in outcome.log
    assert outcome.summary["frames_used"] == FRAMES


def test_a_second_method_that_breaks_costs_nothing_that_was_found(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise ValueError("no such thing")

    monkeypatch.setattr("polhode.pipeline.correspondences.combine_features", broken)
    outcome = run(SCENE, OTHER)
    assert outcome.code == 0 and outcome.summary["frames_used"] == FRAMES
    assert "the second feature method failed" in outcome.log and "no such thing" in outcome.log


def test_the_second_method_stands_in_where_the_first_sees_nothing(run: Run) -> None:
    outcome = run(replace(SCENE, dropped=tuple(range(1, FRAMES))), OTHER)
    assert outcome.code == 0 and outcome.summary["frames_used"] == FRAMES


def test_a_second_method_that_sees_nothing_changes_nothing(run: Run) -> None:
    outcome = run(SCENE, None)
    assert outcome.code == 0 and outcome.log.count("motion and inertia") <= 3
