"""Checks of a solved sequence without images: an undisturbed one passes, each fault shows where it should."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import exp_so3, inverse_pose, make_pose
from polhode.pipeline.checks.answer_checks import check_answer as module
from polhode.pipeline.checks.answer_checks.check_answer import (
    link_check,
    mirror_check,
)
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.summary_schema import Check
from polhode.run_directory.verdict import reasons_of
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

SCENE = SyntheticScene(
    frames=24, landmarks=400, detection=0.5, sigma_uv_px=0.3, sigma_d_px=0.2, accel_psd=1e-9, torque_psd=1e-9
)
SUN_N = np.array([0.6, -0.4, -0.7]) / np.linalg.norm([0.6, -0.4, -0.7])
CONFIG = Backend()
Solved = tuple[StereoTracks, MotionEstimate]


def solved(tracks: StereoTracks, sequence: SyntheticSequence) -> Solved:
    start = InitialMotion(inverse_pose(sequence.X_NR) @ sequence.X_NG, np.ones(SCENE.frames, dtype=np.bool_))
    return tracks, estimate_motion(tracks, start, CONFIG, Silent())


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(SCENE, 1)


@pytest.fixture(scope="module")
def undisturbed(sequence: SyntheticSequence) -> Solved:
    return solved(sequence.tracks, sequence)


def of_name(checks: list[Check], words: str) -> Check:
    (found,) = [check for check in checks if words in check.name]
    return found


def test_an_undisturbed_sequence_passes_and_a_flat_relief_has_a_near_mirror_twin(undisturbed: Solved) -> None:
    tracks, estimate = undisturbed
    check = mirror_check(tracks, estimate)
    assert check.value is not None and check.value > 0.0 and not check.reason
    near = replace(estimate, noise=replace(estimate.noise, disparity_sigma_px=50.0))
    assert "inside out" in mirror_check(tracks, near).reason


def test_links_that_contradict_the_motion_are_counted(sequence: SyntheticSequence) -> None:
    X_RG = inverse_pose(sequence.X_NR) @ sequence.X_NG
    assert link_check(sequence.relative, X_RG).value == 0.0
    turns = make_pose(exp_so3(np.outer(np.arange(len(X_RG)), [0.0, 0.0, 0.2])), np.zeros((len(X_RG), 3)))
    check = link_check(sequence.relative, X_RG @ turns)
    assert check.value == pytest.approx(100.0) and "100% of the links" in check.reason
    few = RelativePoses(*(values[:5] for values in vars(sequence.relative).values()))
    assert link_check(few, X_RG).value is None


def test_a_check_that_ends_with_an_error_is_a_reason_for_doubt(
    undisturbed: Solved, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*given: object) -> list[Check]:
        raise ValueError("seven is not a pose")

    monkeypatch.setattr(module, "mirror_check", fails)
    none = np.zeros(0, dtype=np.int64)
    links = RelativePoses(none, none, np.zeros((0, 4, 4)), none)
    checks = module.check_answer(*undisturbed, links)
    (reason,) = reasons_of(checks)
    assert "seven is not a pose" in reason
    # the others were made all the same
    assert any(check.name.startswith("displacement beyond") for check in checks)
