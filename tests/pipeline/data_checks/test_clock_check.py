"""A clock that jumps contradicts the rotation; frames that are missing, and a torque, do not."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from polhode.lie import Array
from polhode.pipeline.data_checks.pose_checks import clock_check
from polhode.pipeline.run_directory.verdict import reasons_of
from polhode.rigid_body import propagate

Floats = NDArray[np.floating[Any]]
J = np.diag([1.5, 1.2, 0.9])


def attitudes(time_s: Floats, w: tuple[float, float, float] = (0.8, 0.2, 0.2)) -> Array:
    return np.asarray(propagate(time_s, np.zeros(3), np.zeros(3), np.eye(3), np.array(w), J)[2])


def stated(time_s: Floats, stamps_s: Floats) -> list[str]:
    seen = np.ones(len(time_s), dtype=np.bool_)
    return reasons_of([clock_check(np.asarray(stamps_s, dtype=np.float64), attitudes(time_s), seen)])


TIME_S: Array = np.linspace(0.0, 14.5, 30)


@pytest.mark.parametrize("jump_s", [0.8, 0.1, -0.3])
def test_a_jump_is_named_with_the_times(jump_s: float) -> None:
    said = stated(TIME_S, TIME_S + jump_s * (np.arange(30) >= 12))
    assert len(said) == 1 and "most after 5.5 s" in said[0]
    assert f"within the {0.5 + jump_s:.2f} s" in said[0] and "in 0.50 s" in said[0]


def test_missing_frames_and_uneven_intervals_are_no_jumps() -> None:
    kept = TIME_S[np.random.default_rng(0).random(30) < 0.7]
    assert stated(kept, kept) == []
    uneven = np.cumsum(np.random.default_rng(1).uniform(0.3, 0.7, 30))
    assert stated(uneven, uneven) == []


def test_a_torque_between_two_frames_is_no_jump() -> None:
    before = attitudes(TIME_S[:15])
    after = before[-1] @ attitudes(TIME_S[:16], (0.7, 0.3, 0.3))[1:]
    R_NG = np.concatenate([before, after])
    check = clock_check(TIME_S, R_NG, np.ones(30, dtype=np.bool_))
    assert check.value is not None and check.reason == ""


def test_a_target_at_rest_and_frames_without_observations_say_nothing() -> None:
    still = np.tile(np.eye(3), (30, 1, 1))
    jumped = np.asarray(TIME_S + 0.8 * (np.arange(30) >= 12), dtype=np.float64)
    assert clock_check(jumped, still, np.ones(30, dtype=np.bool_)).value is None
    assert clock_check(jumped, attitudes(TIME_S), np.zeros(30, dtype=np.bool_)).value is None
