"""With which earlier frames a new one is matched, and which key frames of a long stream stay."""

import numpy as np

from polhode.frontend.matching.frame_choice import (
    APART_FRAMES,
    FIRST_FRAMES,
    LET_GO_AT_A_TIME,
    MOST_IN_VIEW,
    earlier_frames,
    frames_to_let_go,
    viewing_direction_G,
)
from polhode.frontend.matching.pairs import MAX_NEIGHBOUR_STEPS
from polhode.geometry.lie import Array, exp_so3, make_pose


def turning(frames: int, period: int = 40) -> Array:
    """(frames, 3) viewing directions of a target that turns once in ``period`` frames."""
    angle = 2.0 * np.pi * np.arange(frames) / period
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(frames)])


def test_the_first_frames_are_matched_with_all_before_and_those_of_unknown_view_with_neighbours() -> None:
    np.testing.assert_array_equal(earlier_frames(turning(FIRST_FRAMES, 20), None), np.arange(FIRST_FRAMES))
    assert len(earlier_frames(np.zeros((0, 3)), None)) == 0
    neighbours = np.arange(30 - MAX_NEIGHBOUR_STEPS, 30)
    unknown = np.full((30, 3), np.nan)
    np.testing.assert_array_equal(earlier_frames(unknown, np.array([1.0, 0.0, 0.0])), neighbours)
    np.testing.assert_array_equal(earlier_frames(turning(30, 10), None), neighbours)


def test_after_a_revolution_the_frames_of_the_same_side_are_found() -> None:
    views = turning(101)
    chosen = earlier_frames(views[:100], views[100])
    # the same side was seen at 20 and at 60
    assert {20, 60, *range(100 - MAX_NEIGHBOUR_STEPS, 100)} <= set(chosen.tolist())
    distant = chosen[chosen < 100 - MAX_NEIGHBOUR_STEPS]
    assert len(distant) <= MOST_IN_VIEW
    assert (views[distant] @ views[100] > np.cos(np.deg2rad(70.0))).all()
    # of frames that show nearly the same one is taken
    fast, slow = turning(401), turning(401, 400)
    of_fast, of_slow = (earlier_frames(views[:400], views[400]) for views in (fast, slow))
    assert len(of_fast) == len(of_slow) == MAX_NEIGHBOUR_STEPS + MOST_IN_VIEW
    assert np.diff(of_fast).min() == 1
    assert np.diff(of_slow[of_slow < 400 - MAX_NEIGHBOUR_STEPS]).min() >= APART_FRAMES
    # the revolution before is found as well
    assert of_slow.min() < 20


def test_the_viewing_direction_points_from_the_target_to_the_camera() -> None:
    R_NG = exp_so3([0.0, np.pi / 2.0, 0.0])
    found = viewing_direction_G(np.eye(4), make_pose(R_NG, [0.0, 0.0, 2.0]))
    np.testing.assert_allclose(found, R_NG.T @ [0.0, 0.0, -1.0], atol=1e-12)


def test_the_first_and_the_latest_frames_stay_and_one_of_unknown_view_leaves_first() -> None:
    assert len(frames_to_let_go(turning(20), np.arange(20.0), 20)) == 0
    assert len(frames_to_let_go(turning(100), np.arange(100.0), 20)) == LET_GO_AT_A_TIME
    views = np.tile([0.0, 0.0, 1.0], (80, 1))
    gone = frames_to_let_go(views[:60], np.arange(60.0), 10, most=60)
    assert len(gone) == 50 and 0 not in gone and gone.max() < 60 - MAX_NEIGHBOUR_STEPS
    # the only frame of a side stays
    views[33] = [1.0, 0.0, 0.0]
    assert 33 not in frames_to_let_go(views, np.arange(80.0), 12, most=80)
    views = turning(30)
    views[[7, 11]] = np.nan
    np.testing.assert_array_equal(frames_to_let_go(views, np.arange(30.0), 28), [7, 11])


def test_of_many_turns_every_view_stays_of_the_beginning_and_of_the_end() -> None:
    count, number = 1000, 60
    views, time_s, kept = turning(count), np.arange(float(count)), np.zeros(0, dtype=np.int64)
    for k in range(count):
        kept = np.append(kept, k)
        kept = np.delete(kept, frames_to_let_go(views[kept], time_s[kept], number))
    assert len(kept) == number
    nearest_deg = np.rad2deg(np.arccos(np.clip(views @ views[kept].T, -1.0, 1.0))).min(axis=1)
    assert nearest_deg.max() < 25.0
    # between them the gaps in time are a matter of rounding
    assert np.sum(kept < count // 2) >= number // 6 and np.sum(kept >= count // 2) >= number // 6
