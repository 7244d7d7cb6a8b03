"""All checks together: what a frozen recorder and a check that fails lead to."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.pipeline.data_checks import check_data as module
from polhode.pipeline.data_checks.check_data import FROZEN, check_data
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.progress import Silent
from polhode.records import InitialMotion, MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate


@pytest.fixture(scope="module")
def solved() -> tuple[SyntheticSequence, MotionEstimate]:
    sequence = generate(SyntheticScene(frames=16, landmarks=240, J_G=np.diag([1.5, 1.2, 0.9])), 3)
    tracks = sequence.tracks
    start = InitialMotion(np.linalg.inv(tracks.X_NR) @ sequence.X_NG, np.ones(16, dtype=np.bool_))
    return sequence, estimate_motion(tracks, start, Backend(), Silent())


def context(sequence: SyntheticSequence, frozen: bool = False) -> Any:
    tracks = sequence.tracks
    return SimpleNamespace(
        sequence=SimpleNamespace(frozen=frozen, has_ranges=False),
        clock=lambda name: nullcontext(),
        config=SimpleNamespace(backend=Backend()),
        rectifier=SimpleNamespace(found=None),
        rig=tracks.rig,
        time_s=tracks.time_s,
        X_NR=tracks.X_NR,
    )


def test_images_that_are_all_the_same_are_a_reason(solved: tuple[SyntheticSequence, MotionEstimate]) -> None:
    sequence, estimate = solved
    assert check_data(context(sequence), [], sequence.tracks, estimate).reasons == []
    assert check_data(context(sequence, frozen=True), [], sequence.tracks, estimate).reasons == [FROZEN]


def test_a_check_that_ends_with_an_error_costs_only_itself_and_is_a_reason(
    solved: tuple[SyntheticSequence, MotionEstimate], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, estimate = solved

    def fail(*words: object) -> list[str]:
        raise ZeroDivisionError

    jumped = Check(name="stamps", limit=8.0).judged(20.0, "the clock jumped")
    monkeypatch.setattr(module, "rig_checks", fail)
    monkeypatch.setattr(module, "clock_check", lambda *words: jumped)
    failed, other = check_data(context(sequence), [], sequence.tracks, estimate).reasons
    assert "a check ended with an error (ZeroDivisionError" in failed and other == "the clock jumped"


def test_parts_that_no_landmark_connects_are_a_reason(
    solved: tuple[SyntheticSequence, MotionEstimate],
) -> None:
    sequence, estimate = solved
    tracks = sequence.tracks
    # landmarks get other numbers from the tenth frame on
    parted = np.where(tracks.frame < 9, tracks.landmark, tracks.landmark + tracks.n_landmarks)
    landmark = np.unique(parted, return_inverse=True)[1]
    (reason,) = check_data(context(sequence), [], replace(tracks, landmark=landmark), estimate).reasons
    assert "share no landmarks and are connected by the dynamics alone" in reason
