"""A disc whose texture turns within a still outline: a wrong motion shows in the images."""

import cv2
import numpy as np
import pytest

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.pipeline.checks.answer_checks.image_motion import ImageMotion, residual_displacement, warp_back
from polhode.records.surface import DepthMap

RIG = RectifiedRig(200.0, 79.5, 79.5, 0.1, 160, 160)
STEP_DEG, FRAMES = 9.0, 8
RADIUS_PX = np.hypot(*(np.mgrid[0:160, 0:160] - 79.5))


def turned(turn_deg: float, textured: bool = True) -> DepthMap:
    """A disc of 60 px radius, its texture turned about the middle of the image; above a black background."""
    noise = np.random.default_rng(0).uniform(20.0, 235.0, (160, 160))
    grey = np.asarray(cv2.GaussianBlur(noise, (0, 0), 2.0)) if textured else np.full_like(noise, 128.0)
    spread = (grey - grey.mean()) / max(float(grey.std()), 1e-6) * 35.0
    rotation = cv2.getRotationMatrix2D((79.5, 79.5), -turn_deg, 1.0)
    picture = cv2.warpAffine(np.clip(128.0 + spread, 0, 255), rotation, (160, 160))
    inside = RADIUS_PX < 60.0
    z = np.where(inside, 1.0, np.nan).astype(np.float32)
    return DepthMap(z, np.full_like(z, 1e-3), np.where(inside, picture, 0.0).astype(np.uint8), inside)


def poses(step_deg: float) -> Array:
    """The disc's poses in the camera; about the optical axis, u towards v."""
    turns = exp_so3(np.outer(np.deg2rad(step_deg) * np.arange(FRAMES), [0.0, 0.0, 1.0]))
    return make_pose(turns, np.tile([0.0, 0.0, 1.0], (FRAMES, 1)))


def watched(step_deg: float, maps: list[DepthMap], unseen: int | None = None) -> ImageMotion:
    images = ImageMotion(RIG, poses(step_deg), np.arange(FRAMES) != unseen)
    images.compare(maps)
    return images


@pytest.fixture(scope="module")
def turning() -> list[DepthMap]:
    return [turned(STEP_DEG * k) for k in range(FRAMES)]


def test_the_true_motion_leaves_no_flow_and_another_than_that_of_the_skin_is_doubted(
    turning: list[DepthMap],
) -> None:
    images = watched(STEP_DEG, turning)
    assert len(images.shares) == FRAMES - 1 and max(images.shares) < 0.1
    check = images.checks(0.5)[0]
    assert check.reason == "" and check.value is not None and check.value < 10.0
    # a still outline, and the opposite direction
    for found_deg in (0.0, -STEP_DEG):
        images = watched(found_deg, turning)
        # 9 degrees displace by more than 2 px what is more than 13 px from the axis
        assert np.median(images.shares) > 0.8
        assert "the images do not move as the motion found" in images.checks(0.5)[0].reason


def test_surfaces_without_texture_say_nothing_and_frames_that_look_too_different_are_not_compared(
    turning: list[DepthMap],
) -> None:
    images = watched(0.0, [turned(STEP_DEG * k, textured=False) for k in range(FRAMES)])
    assert images.shares == [] and images.checks(0.5)[0].value is None
    assert watched(50.0, turning).shares == watched(90.0, turning).shares == []


def test_frames_without_measurements_or_depth_are_left_out(turning: list[DepthMap]) -> None:
    assert len(watched(STEP_DEG, turning, unseen=3).shares) == FRAMES - 3
    empty = np.full((160, 160), np.nan, dtype=np.float32)
    hidden = DepthMap(empty, empty, turning[5].intensity, turning[5].target)
    assert len(watched(STEP_DEG, [*turning[:5], hidden, *turning[6:]]).shares) == FRAMES - 2


def test_the_second_image_is_moved_back_where_depth_is_known(turning: list[DepthMap]) -> None:
    first, second = turning[:2]
    X = poses(STEP_DEG)[1] @ np.linalg.inv(poses(STEP_DEG)[0])
    back, known = warp_back(first, second, X, RIG)
    assert known.sum() == first.target.sum()
    inner = RADIUS_PX < 50.0
    error = np.abs(back.astype(float) - first.intensity)[inner]
    assert np.median(error) < 4.0
    assert np.median(np.abs(second.intensity.astype(float) - first.intensity)[inner]) > 20.0
    assert np.median(residual_displacement(first, second, X, RIG)) < 0.3
    # behind the camera nothing is known
    assert not warp_back(first, second, make_pose(np.eye(3), [0.0, 0.0, -2.0]), RIG)[1].any()
