"""Cylinders whose marks turn within a still outline: does the turn found show in the images?"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.pipeline.checks.answer_checks import symmetry_turn
from polhode.pipeline.checks.answer_checks.symmetry_turn import (
    MAX_SLIP,
    rotation_check,
    share_beyond_outline,
    slippable_axis,
    views_of_pairs,
)
from polhode.records.surface import DepthMap
from polhode.run_directory.summary_schema import Check

RIG = RectifiedRig(400.0, 79.5, 79.5, 0.1, 160, 160)
RADIUS_M, HALF_M, DISTANCE_M = 0.1, 0.09, 0.6
STEP_DEG, FRAMES = 9.0, 6
BARE = np.full((128, 720), 128.0)


def rich() -> Array:
    """Marks around the cylinder (rows along it): grey values (128, 720)."""
    noise = np.tile(np.random.default_rng(3).uniform(0.0, 255.0, (128, 720)), (1, 3))
    blurred = cv2.GaussianBlur(noise, (0, 0), 4.0)[:, 720:1440]
    return np.asarray(128.0 + (blurred - blurred.mean()) / blurred.std() * 35.0)


def sparse() -> Array:
    """Eight marks."""
    rng, out = np.random.default_rng(4), BARE.copy()
    for k in range(8):
        row = int(rng.integers(10, 100))
        out[row : row + 14, 90 * k + 20 : 90 * k + 55] = 60.0
    return out


def frame(marks: Array, turn_deg: float, box: bool = False) -> DepthMap:
    """The cylinder (or a box of the same outline), its axis along v; a ring and a still shadow's edge."""
    rng = np.random.default_rng(int(1e3 * abs(turn_deg)))
    v, u = np.mgrid[0:160, 0:160] - 79.5
    x, y = u / RIG.focal_px, v / RIG.focal_px
    # | (x z, z - d) | = r
    a, b, c = x**2 + 1.0, -2.0 * DISTANCE_M, DISTANCE_M**2 - RADIUS_M**2
    inner = b**2 - 4.0 * a * c
    z = (-b - np.sqrt(np.maximum(inner, 0.0))) / (2.0 * a)
    if box:
        z = np.where(u > 0.0, 0.53 + 0.4 * x, 0.53 - 1.1 * x) + 0.35 * np.abs(y)
    known = (inner > 0.0) & (np.abs(y * z) < HALF_M)
    angle = np.rad2deg(np.arctan2(x * z, DISTANCE_M - z)) - turn_deg
    row = np.clip((y * z / HALF_M + 1.0) * 64.0, 0, 127)
    grey = cv2.remap(
        marks.astype(np.float32), ((2.0 * angle) % 720.0).astype(np.float32), row.astype(np.float32),
        cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP,
    )  # fmt: skip
    ring = np.where(np.abs(y * z - 0.04) < 0.006, 0.5, 1.0)
    grey = grey * (0.6 + 0.4 * np.cos(np.deg2rad(angle + turn_deg))) * ring
    grey = np.where(x * z > 0.05, 0.8 * grey, grey) + rng.normal(0.0, 1.5, grey.shape)
    image = np.where(known, np.clip(grey, 0.0, 255.0), 0.0).astype(np.uint8)
    depth = np.where(known, z, np.nan).astype(np.float32)
    return DepthMap(depth, np.full_like(depth, 1e-3), image, known)


def plate(turn_deg: float) -> DepthMap:
    """A plain plate of 3 to 1 across the line of sight, turned about it."""
    v, u = np.mgrid[0:160, 0:160] - 79.5
    turn = np.deg2rad(turn_deg)
    a, b = np.cos(turn) * u + np.sin(turn) * v, np.cos(turn) * v - np.sin(turn) * u
    known = (np.abs(a) < 60.0) & (np.abs(b) < 20.0)
    image = np.where(known, 128, 0).astype(np.uint8)
    depth = np.where(known, DISTANCE_M, np.nan).astype(np.float32)
    return DepthMap(depth, np.full_like(depth, 1e-3), image, known)


def turn_check_of(marks: Array, found_deg: float, box: bool = False, every: int = 1) -> Check:
    """Of a target that turns by STEP_DEG from frame to frame, for the turn that was found; from every so many
    points of each pair.
    """
    # about the axis along v; u grows with the angle, as seen from the camera
    turns = exp_so3(np.outer(-np.deg2rad(found_deg) * np.arange(FRAMES), [0.0, 1.0, 0.0]))
    X_RG = make_pose(turns, np.tile([0.0, 0.0, DISTANCE_M], (FRAMES, 1)))
    maps = [frame(marks, STEP_DEG * k, box) for k in range(FRAMES)]
    views = [
        replace(view, p_G=view.p_G[::every], normal_G=view.normal_G[::every])
        for view in views_of_pairs(maps, X_RG, np.ones(FRAMES, dtype=np.bool_), RIG)
    ]
    return rotation_check(views, RIG, 0.5)


def test_the_turn_of_a_marked_body_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    checks = [turn_check_of(marks, STEP_DEG) for marks in (rich(), sparse())]
    # large pictures are reduced
    monkeypatch.setattr(symmetry_turn, "MAX_SIDE_PX", 70)
    for check in (*checks, turn_check_of(rich(), STEP_DEG)):
        assert check.reason == "" and check.value is not None and check.value > 0.2
    assert turn_check_of(rich(), 0.0).reason


@pytest.mark.parametrize("found_deg", [0.0, -STEP_DEG])
def test_another_turn_than_that_of_the_marks_is_contradicted(found_deg: float) -> None:
    check = turn_check_of(rich(), found_deg)
    assert check.value is not None and check.value < -0.3
    assert "the images contradict it" in check.reason
    words = check.reason.split("differs by ")[1].split(" ")[0]
    assert float(words) == pytest.approx((STEP_DEG - found_deg) / 0.5, abs=4.0)


def test_on_a_bare_body_nothing_shows_the_turn_and_one_without_symmetry_is_not_judged() -> None:
    # found at rest, nothing speaks for it; found turning, the still edge of the shadow speaks against it
    assert "its surface shows too little of it" in turn_check_of(BARE, 0.0).reason
    assert "contradict it" in turn_check_of(BARE, STEP_DEG).reason
    assert turn_check_of(rich(), STEP_DEG, box=True).value is None
    assert turn_check_of(rich(), STEP_DEG, every=30).value is None, "nothing to compare"


def test_a_plate_moves_along_itself_but_leaves_its_outline() -> None:
    turns = exp_so3(np.outer(np.deg2rad(STEP_DEG) * np.arange(FRAMES), [0.0, 0.0, 1.0]))
    X_RG = make_pose(turns, np.tile([0.0, 0.0, DISTANCE_M], (FRAMES, 1)))
    maps = [plate(STEP_DEG * k) for k in range(FRAMES)]
    views = views_of_pairs(maps, X_RG, np.ones(FRAMES, dtype=np.bool_), RIG)
    axis = slippable_axis(
        *(np.concatenate([getattr(v, name) for v in views]) for name in ("p_G", "normal_G"))
    )
    assert axis.slip < 0.01
    # points 4 px and more inside of the rectangle, turned, beyond it by 3 px and more
    inner = np.mgrid[-55:56, -15:16].reshape(2, -1)
    turned = [exp_so3(np.deg2rad([0.0, 0.0, deg]))[:2, :2] @ inner for deg in (30.0, 60.0)]
    beyond = np.mean([(np.abs(uv[0]) > 63.0) | (np.abs(uv[1]) > 23.0) for uv in turned])
    assert share_beyond_outline(views, axis, RIG) == pytest.approx(beyond, abs=0.03)
    assert rotation_check(views, RIG, 0.5).value is None


def test_the_axis_of_a_cone_is_found_from_its_points_and_normals() -> None:
    rng = np.random.default_rng(5)
    angle, height = rng.uniform(0.0, np.pi, 500), rng.uniform(0.1, 0.3, 500)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    p = np.column_stack([0.5 * height[:, None] * out, height])
    normal = np.column_stack([out, np.full(500, -0.5)]) / np.sqrt(1.25)
    X = make_pose(exp_so3([0.4, -0.3, 0.8]), np.array([0.1, 0.2, 0.5]))
    axis = slippable_axis(p @ X[:3, :3].T + X[:3, 3], normal @ X[:3, :3].T)
    assert axis.slip < 0.01
    assert abs(axis.direction_G @ X[:3, 2]) == pytest.approx(1.0, abs=1e-3)
    offset = axis.point_G - X[:3, 3]
    assert np.linalg.norm(offset - (offset @ X[:3, 2]) * X[:3, 2]) < 2e-3
    # a quarter of the body stands out
    more = np.concatenate([p, rng.uniform(-0.3, 0.3, (170, 3))])
    assert slippable_axis(more, np.concatenate([normal, np.tile([0.0, 1.0, 0.0], (170, 1))])).slip > MAX_SLIP
