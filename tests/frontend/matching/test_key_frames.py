"""Key frames of a long stream: spread over views and time, the rest let go."""

import numpy as np

from polhode.frontend.matching.key_frames import LET_GO_AT_A_TIME, frames_to_let_go
from polhode.frontend.matching.pairs import MAX_NEIGHBOUR_STEPS
from polhode.geometry.lie import Array


def turning(count: int, frames_a_turn: int = 40) -> Array:
    angle = 2.0 * np.pi * np.arange(count) / frames_a_turn
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)


def test_up_to_the_number_all_stay() -> None:
    assert len(frames_to_let_go(turning(20), np.arange(20.0), 20)) == 0


def test_no_frame_waits_for_many_to_leave() -> None:
    assert len(frames_to_let_go(turning(100), np.arange(100.0), 20)) == LET_GO_AT_A_TIME


def test_the_first_and_the_latest_stay_whatever_they_show() -> None:
    views = np.tile([0.0, 0.0, 1.0], (60, 1))
    gone = frames_to_let_go(views, np.arange(60.0), 10, most=60)
    assert len(gone) == 50
    assert 0 not in gone
    assert gone.max() < 60 - MAX_NEIGHBOUR_STEPS


def test_a_frame_of_unknown_view_leaves_first() -> None:
    views = turning(30)
    views[[7, 11]] = np.nan
    np.testing.assert_array_equal(frames_to_let_go(views, np.arange(30.0), 28), [7, 11])


def test_of_many_turns_every_view_and_every_time_stays() -> None:
    count, number = 2000, 60
    views, time_s, kept = turning(count), np.arange(float(count)), np.zeros(0, dtype=np.int64)
    for k in range(count):
        kept = np.append(kept, k)
        kept = np.delete(kept, frames_to_let_go(views[kept], time_s[kept], number))
    assert len(kept) == number
    nearest_deg = np.rad2deg(np.arccos(np.clip(views @ views[kept].T, -1.0, 1.0))).min(axis=1)
    assert nearest_deg.max() < 25.0
    assert np.diff(kept).max() < count / 4


def test_the_only_frame_of_a_side_stays() -> None:
    views = np.tile([0.0, 0.0, 1.0], (80, 1))
    views[33] = [1.0, 0.0, 0.0]
    assert 33 not in frames_to_let_go(views, np.arange(80.0), 12, most=80)
