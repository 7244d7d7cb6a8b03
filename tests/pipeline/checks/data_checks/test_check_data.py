"""All checks together: a frozen recorder, a check that fails, masks that were found."""

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
from polhode.pipeline.context import doubts_of_masks
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import make_check
from polhode.run_directory.verdict import reasons_of
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, generate

Solved = tuple[StereoTracks, MotionEstimate]


@pytest.fixture(scope="module")
def solved() -> Solved:
    sequence = generate(SyntheticScene(frames=16, landmarks=160, J_G=np.diag([1.5, 1.2, 0.9])), 3)
    tracks = sequence.tracks
    start = InitialMotion(np.linalg.inv(tracks.X_NR) @ sequence.X_NG, np.ones(16, dtype=np.bool_))
    return tracks, estimate_motion(tracks, start, Backend(), Silent())


def reasons(tracks: StereoTracks, estimate: MotionEstimate, frozen: bool = False) -> list[str]:
    context: Any = SimpleNamespace(
        sequence=SimpleNamespace(frozen=frozen, has_ranges=False),
        config=SimpleNamespace(backend=Backend()),
        rectifier=SimpleNamespace(found=None),
        rig=tracks.rig,
        time_s=tracks.time_s,
        X_NR=tracks.X_NR,
    )
    return reasons_of(check_data(context, [], tracks, estimate).checks)


def test_images_that_are_all_the_same_and_parts_that_no_landmark_connects_are_reasons(solved: Solved) -> None:
    tracks, estimate = solved
    assert reasons(tracks, estimate) == []
    # landmarks get other numbers from the tenth frame on
    parted = np.where(tracks.frame < 9, tracks.landmark, tracks.landmark + tracks.n_landmarks)
    landmark = np.unique(parted, return_inverse=True)[1]
    frozen, apart = reasons(replace(tracks, landmark=landmark), estimate, frozen=True)
    assert "the same, bit for bit" in frozen
    assert "share no landmarks and are connected by the dynamics alone" in apart


def test_a_check_that_ends_with_an_error_costs_only_itself_and_is_a_reason(
    solved: Solved, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*words: object) -> list[str]:
        raise ZeroDivisionError

    jumped = make_check("clock", 20.0, from_s=5.5, stated_s=1.0, needed_s=0.5)
    monkeypatch.setattr(module, "rig_checks", fail)
    monkeypatch.setattr(module, "clock_check", lambda *words: jumped)
    failed, other = reasons(*solved)
    assert "a check ended with an error (ZeroDivisionError" in failed and "the clock may have jumped" in other


@pytest.mark.parametrize("bad", [0, 2, 5])
def test_many_doubtful_masks_are_a_doubt_of_the_answer_and_a_few_a_warning(bad: int) -> None:
    good = MaskQuality(area=0.1, agreement=0.98, contradicted=0.02, far_share=0.95)
    found = FoundMasks({}, dict(enumerate([replace(good, agreement=0.4)] * bad + [good] * (20 - bad))))
    (check,) = mask_checks(found)
    assert (check.value, check.limit) == (5.0 * bad, 20.0) and mask_checks(None) == []
    named = {0: "", 2: "(frames 0, 1):", 5: "(frames 0, 1, 2, ...):"}[bad]
    doubts = doubts_of_masks(found)
    assert named in doubts and bool(doubts) == (bad > 0) and ("give masks" in doubts) == (bad > 0)
    assert check.reason == (doubts if bad == 5 else "")
