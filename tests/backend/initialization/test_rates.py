"""Frames that a look-alike side has turned are found, and nothing else."""

import numpy as np
import pytest

from polhode.backend.initialization.rates import jumping_frames
from polhode.geometry.lie import Array, Bools, exp_so3
from polhode.geometry.rigid_body import propagate

HALF_TURN = np.diag([1.0, -1.0, -1.0])
TIME_S: Array = 0.2 * np.arange(75.0)


def _tumble(rate_rad_s: float = 2.1) -> Array:
    """Attitudes (75, 3, 3) of a body that nutates widely."""
    w = rate_rad_s * np.array([0.2, 0.95, 0.25])
    return propagate(TIME_S, np.zeros(3), np.zeros(3), np.eye(3), w, np.diag([1.3, 1.0, 0.6]))[2]


@pytest.mark.parametrize("turned", [[1, 2], [26, 27, 28], [66, 67], [1, 2, 26, 27, 28, 66, 67], [0], [74]])
def test_frames_that_are_off_by_a_symmetry_are_found(turned: list[int]) -> None:
    R_NG = _tumble()
    R_NG[turned] = R_NG[turned] @ HALF_TURN
    assert np.flatnonzero(jumping_frames(TIME_S, R_NG, np.ones(75, bool))).tolist() == turned


@pytest.mark.parametrize("lost", [range(0), range(20, 30)])
def test_a_true_tumble_has_none(lost: range) -> None:
    connected: Bools = np.ones(75, bool)
    connected[list(lost)] = False
    noise = np.random.default_rng(1).normal(0, 0.05, (75, 3))
    assert not jumping_frames(TIME_S, np.asarray(_tumble(1.0) @ exp_so3(noise)), connected).any()


def test_nothing_is_removed_when_most_is_in_doubt_or_the_body_turns_far_between_frames() -> None:
    R_NG = _tumble()
    # two halves that contradict each other: neither is the odd one
    R_NG[37:] = R_NG[37:] @ HALF_TURN
    for each in (R_NG, *(_tumble(np.deg2rad(turn_deg) / 0.2) for turn_deg in (100.0, 140.0, 190.0))):
        assert not jumping_frames(TIME_S, each, np.ones(75, bool)).any()
