"""A disc whose texture turns within a still outline: a wrong motion shows in the images."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.pipeline.checks.answer_checks.image_motion import ImageMotion, residual_displacement, warp_back
from polhode.records.surface import DepthMap

RIG = RectifiedRig(200.0, 79.5, 79.5, 0.1, 160, 160)
STEP_DEG = 9.0
FRAMES = 8


def picture(turn_deg: float, textured: bool = True) -> NDArray[np.uint8]:
    """A disc of 60 px radius, its texture turned about the middle of the image; above a black background."""
    noise = np.random.default_rng(0).uniform(20.0, 235.0, (160, 160))
    grey = np.asarray(cv2.GaussianBlur(noise, (0, 0), 2.0)) if textured else np.full_like(noise, 128.0)
    spread = (grey - grey.mean()) / max(float(grey.std()), 1e-6) * 35.0
    turned = cv2.warpAffine(
        np.clip(128.0 + spread, 0, 255), cv2.getRotationMatrix2D((79.5, 79.5), -turn_deg, 1.0), (160, 160)
    )
    v, u = np.mgrid[0:160, 0:160] - 79.5
    return np.where(np.hypot(u, v) < 60.0, turned, 0.0).astype(np.uint8)


def depth(image: NDArray[np.uint8]) -> DepthMap:
    v, u = np.mgrid[0:160, 0:160] - 79.5
    inside = np.hypot(u, v) < 60.0
    z = np.where(inside, 1.0, np.nan).astype(np.float32)
    return DepthMap(z, np.full_like(z, 1e-3), image, inside)


def poses(step_deg: float) -> Array:
    """The disc's poses in the camera; about the optical axis, u towards v."""
    turns = [exp_so3([0.0, 0.0, np.deg2rad(step_deg * k)]) for k in range(FRAMES)]
    return np.stack([make_pose(R, np.array([0.0, 0.0, 1.0])) for R in turns])


def watched(step_deg: float, maps: list[DepthMap], measured: object = None) -> ImageMotion:
    seen = np.ones(FRAMES, dtype=np.bool_) if measured is None else np.asarray(measured)
    images = ImageMotion(RIG, poses(step_deg), seen)
    images.compare(maps)
    return images


def turning(textured: bool = True) -> list[DepthMap]:
    return [depth(picture(STEP_DEG * k, textured)) for k in range(FRAMES)]


def test_the_true_motion_leaves_no_flow() -> None:
    images = watched(STEP_DEG, turning())
    assert len(images.shares) == FRAMES - 1 and max(images.shares) < 0.1
    check = images.checks(0.5)[0]
    assert check.reason == "" and check.value is not None and check.value < 10.0


@pytest.mark.parametrize("found_deg", [0.0, -STEP_DEG], ids=["a still outline", "the opposite direction"])
def test_another_motion_than_that_of_the_skin_is_doubted(found_deg: float) -> None:
    images = watched(found_deg, turning())
    # 9 degrees displace by more than 2 px what is more than 13 px from the axis
    assert np.median(images.shares) > 0.8
    assert "the images do not move as the motion found" in images.checks(0.5)[0].reason


def test_surfaces_without_texture_say_nothing() -> None:
    images = watched(0.0, turning(textured=False))
    assert images.shares == [] and images.checks(0.5)[0].value is None


@pytest.mark.parametrize("steps_deg", [50.0, 90.0])
def test_frames_that_look_too_different_are_not_compared(steps_deg: float) -> None:
    assert watched(steps_deg, turning()).shares == []


def test_frames_without_measurements_or_depth_are_left_out() -> None:
    measured = np.ones(FRAMES, dtype=np.bool_)
    measured[3] = False
    assert len(watched(STEP_DEG, turning(), measured).shares) == FRAMES - 3
    maps = turning()
    empty = np.full((160, 160), np.nan, dtype=np.float32)
    maps[5] = DepthMap(empty, empty, maps[5].intensity, maps[5].target)
    assert len(watched(STEP_DEG, maps).shares) == FRAMES - 2


def test_the_second_image_is_moved_back_where_depth_is_known() -> None:
    first, second = depth(picture(0.0)), depth(picture(STEP_DEG))
    X = poses(STEP_DEG)[1] @ np.linalg.inv(poses(STEP_DEG)[0])
    back, known = warp_back(first, second, X, RIG)
    assert known.sum() == first.target.sum()
    inner = np.hypot(*(np.mgrid[0:160, 0:160] - 79.5)) < 50.0
    error = np.abs(back.astype(float) - first.intensity)[inner]
    assert np.median(error) < 4.0
    assert np.median(np.abs(second.intensity.astype(float) - first.intensity)[inner]) > 20.0
    assert np.median(residual_displacement(first, second, X, RIG)) < 0.3
    # behind the camera nothing is known
    behind = make_pose(np.eye(3), np.array([0.0, 0.0, -2.0]))
    assert not warp_back(first, second, behind, RIG)[1].any()
