"""A new frame is matched with the latest ones, and with those that saw the same side."""

import numpy as np

from polhode.frontend.matching.earlier_frames import (
    APART_FRAMES,
    FIRST_FRAMES,
    MOST_IN_VIEW,
    earlier_frames,
    viewing_direction_G,
)
from polhode.frontend.matching.pairs import MAX_NEIGHBOUR_STEPS
from polhode.geometry.lie import Array, exp_so3, make_pose


def turning(frames: int, period: int) -> Array:
    """(frames, 3) viewing directions of a target that turns once in ``period`` frames."""
    angle = 2.0 * np.pi * np.arange(frames) / period
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(frames)])


def test_the_first_frames_are_matched_with_all_before() -> None:
    np.testing.assert_array_equal(earlier_frames(turning(FIRST_FRAMES, 20), None), np.arange(FIRST_FRAMES))
    assert len(earlier_frames(np.zeros((0, 3)), None)) == 0


def test_after_a_revolution_the_frames_of_the_same_side_are_found() -> None:
    views = turning(101, 40)
    chosen = earlier_frames(views[:100], views[100])
    assert set(range(100 - MAX_NEIGHBOUR_STEPS, 100)) <= set(chosen.tolist())
    # the same side was seen at 20 and at 60
    assert {20, 60} <= set(chosen.tolist())
    distant = chosen[chosen < 100 - MAX_NEIGHBOUR_STEPS]
    assert len(distant) <= MOST_IN_VIEW
    assert (views[distant] @ views[100] > np.cos(np.deg2rad(70.0))).all()


def test_of_frames_that_show_nearly_the_same_one_is_taken() -> None:
    fast, slow = turning(401, 40), turning(401, 400)
    of_fast, of_slow = (earlier_frames(views[:400], views[400]) for views in (fast, slow))
    assert len(of_fast) == len(of_slow) == MAX_NEIGHBOUR_STEPS + MOST_IN_VIEW
    assert np.diff(of_fast).min() == 1
    assert np.diff(of_slow[of_slow < 400 - MAX_NEIGHBOUR_STEPS]).min() >= APART_FRAMES
    # the revolution before is found as well
    assert of_slow.min() < 20


def test_frames_of_unknown_view_are_only_matched_as_neighbours() -> None:
    unknown = np.full((30, 3), np.nan)
    neighbours = np.arange(30 - MAX_NEIGHBOUR_STEPS, 30)
    np.testing.assert_array_equal(earlier_frames(unknown, np.array([1.0, 0.0, 0.0])), neighbours)
    np.testing.assert_array_equal(earlier_frames(turning(30, 10), None), neighbours)


def test_the_viewing_direction_points_from_the_target_to_the_camera() -> None:
    R_NG = exp_so3([0.0, np.pi / 2.0, 0.0])
    X_NG = make_pose(R_NG, [0.0, 0.0, 2.0])
    np.testing.assert_allclose(viewing_direction_G(np.eye(4), X_NG), R_NG.T @ [0.0, 0.0, -1.0], atol=1e-12)
