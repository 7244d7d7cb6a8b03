"""All checks together: a frozen recorder, a check that fails, masks that were found."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.frontend.found_masks import FoundMasks, MaskQuality
from polhode.pipeline.checks.data_checks import check_data as module
from polhode.pipeline.checks.data_checks.check_data import check_data, mask_checks
from polhode.pipeline.found_background import doubts_of_masks
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.run_directory.check_table import make_check
from polhode.run_directory.verdict import reasons_of
from polhode.runtime.progress import Silent
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


def reasons(given: Any, *case: Any) -> list[str]:
    return reasons_of(check_data(given, [], *case).checks)


def test_images_that_are_all_the_same_are_a_reason(solved: tuple[SyntheticSequence, MotionEstimate]) -> None:
    sequence, estimate = solved
    assert reasons(context(sequence), sequence.tracks, estimate) == []
    (reason,) = reasons(context(sequence, frozen=True), sequence.tracks, estimate)
    assert "the same, bit for bit" in reason


def test_a_check_that_ends_with_an_error_costs_only_itself_and_is_a_reason(
    solved: tuple[SyntheticSequence, MotionEstimate], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, estimate = solved

    def fail(*words: object) -> list[str]:
        raise ZeroDivisionError

    jumped = make_check("clock", 20.0, from_s=5.5, stated_s=1.0, needed_s=0.5)
    monkeypatch.setattr(module, "rig_checks", fail)
    monkeypatch.setattr(module, "clock_check", lambda *words: jumped)
    failed, other = reasons(context(sequence), sequence.tracks, estimate)
    assert "a check ended with an error (ZeroDivisionError" in failed and "the clock may have jumped" in other


def test_parts_that_no_landmark_connects_are_a_reason(
    solved: tuple[SyntheticSequence, MotionEstimate],
) -> None:
    sequence, estimate = solved
    tracks = sequence.tracks
    # landmarks get other numbers from the tenth frame on
    parted = np.where(tracks.frame < 9, tracks.landmark, tracks.landmark + tracks.n_landmarks)
    landmark = np.unique(parted, return_inverse=True)[1]
    (reason,) = reasons(context(sequence), replace(tracks, landmark=landmark), estimate)
    assert "share no landmarks and are connected by the dynamics alone" in reason


@pytest.mark.parametrize("bad", [0, 2, 5])
def test_many_doubtful_masks_are_a_doubt_of_the_answer_and_a_few_a_warning(bad: int) -> None:
    good = MaskQuality(area=0.1, agreement=0.98, contradicted=0.02, far_share=0.95)
    found = FoundMasks({}, dict(enumerate([replace(good, agreement=0.4)] * bad + [good] * (20 - bad))))
    (check,) = mask_checks(found)
    assert (check.value, check.limit) == (5.0 * bad, 20.0)
    named = {0: "", 2: "(frames 0, 1):", 5: "(frames 0, 1, 2, ...):"}[bad]
    doubts = doubts_of_masks(found)
    assert named in doubts and bool(doubts) == (bad > 0) and ("give masks" in doubts) == (bad > 0)
    assert check.reason == (doubts if bad == 5 else "")


def test_where_no_masks_were_found_there_is_no_check_of_them() -> None:
    assert mask_checks(None) == []
