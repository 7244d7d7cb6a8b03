"""The odometry that runs are compared with: depth by disparity, and a frame after a known motion."""

import cv2
import numpy as np
import pytest

from benchmarks.end_to_end.orb_odometry import orb_odometry, stereo_features
from polhode.camera import RectifiedRig
from polhode.frontend.rectification import RectifiedPair

RIG = RectifiedRig(400.0, 159.5, 119.5, 0.1, 320, 240)
DISPARITY_PX = 16
MARGIN_PX = 40


def pair(shift_px: int) -> RectifiedPair:
    """A wall that faces the camera at f b / DISPARITY_PX = 2.5 m, displaced to the right in the images."""
    noise = np.random.default_rng(2).integers(0, 255, (240, 480)).astype(np.uint8)
    wall = cv2.GaussianBlur(noise.astype(np.float64), (0, 0), 2.0)
    wall = np.rint(255.0 * (wall - wall.min()) / np.ptp(wall)).astype(np.uint8)
    left, right = (
        np.ascontiguousarray(wall[:, 80 - shift_px + d : 400 - shift_px + d]) for d in (0, DISPARITY_PX)
    )
    mask = np.zeros((240, 320), dtype=bool)
    mask[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = True
    return RectifiedPair(left, right, mask, np.roll(mask, -DISPARITY_PX, axis=1))


def test_depth_is_that_of_the_disparity() -> None:
    features = stereo_features(pair(0), RIG)
    assert len(features.uv) > 100
    assert np.median(np.abs(features.p_R[:, 2] - 2.5)) < 0.01


def test_the_second_frame_is_displaced_as_the_wall_is() -> None:
    found = orb_odometry([pair(0), pair(8)], RIG)
    assert found.frames.tolist() == [0, 1]
    # 8 px at 2.5 m
    np.testing.assert_allclose(found.X_RG[1, :3, 3], [0.05, 0.0, 0.0], atol=4e-3)
    np.testing.assert_allclose(found.X_RG[1, :3, :3], np.eye(3), atol=3e-3)


def test_a_frame_without_features_has_no_pose() -> None:
    dark = pair(0)
    black = RectifiedPair(
        np.zeros_like(dark.left), np.zeros_like(dark.right), dark.mask_left, dark.mask_right
    )
    found = orb_odometry([pair(0), black, pair(8)], RIG)
    assert found.frames.tolist() == [0, 2]
    assert found.p_G[:, 2] == pytest.approx(2.5, abs=0.2)
