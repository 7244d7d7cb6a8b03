"""Correspondences against mesh vertices, OpenCV's projection, plates before plates, and back again."""

import cv2
import numpy as np
import pytest
import trimesh

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, exp_so3, inverse_pose, log_so3, make_pose
from polhode.simulation.bodies.part import Part, assemble
from polhode.simulation.dataset.correspondence import (
    CameraView,
    correspond,
    view_of,
)
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.stereo_camera import build_cameras
from polhode.simulation.surface.materials import Material
from tests.simulation.small_scenes import TOED_IN, small_scene

MATT = Material(0.4, specular=0.0)


@pytest.fixture(scope="module")
def plan() -> SequencePlan:
    """A free flyer that turns 27 degrees a frame before distorted, toed-in cameras."""
    rig = {"width_px": 160, "height_px": 120, "focal_px": 170.0, **TOED_IN}
    motion = {"position_m": [0.04, 0.0, 0.5], "spin_rpm": [1.0, 9.0, 0.0]}
    return plan_sequence(small_scene(frames=4, rig=rig, motion=motion), 4)


@pytest.fixture(scope="module")
def caster(plan: SequencePlan) -> RayCaster:
    return RayCaster(plan.body)


def _projected(p_G: Array, view: CameraView) -> Array:
    """OpenCV's own projection, pose included."""
    X_KG = inverse_pose(view.X_GK)
    uv, _ = cv2.projectPoints(p_G, log_so3(X_KG[:3, :3]), X_KG[:3, 3], view.camera.K, view.camera.dist)
    return np.asarray(uv, dtype=np.float64).reshape(-1, 2)


@pytest.mark.parametrize("end", [(1, 1), (2, 0)])
def test_points_on_faces_go_where_opencv_projects_them(
    plan: SequencePlan, caster: RayCaster, end: tuple[int, int]
) -> None:
    a, b = view_of(plan, 1, 0), view_of(plan, *end)
    p_G = np.asarray(plan.body.mesh.triangles_center)
    found = correspond(caster, a, b, _projected(p_G, a))
    same_point = np.linalg.norm(found.p_G - p_G, axis=1) < 1e-6
    assert same_point.sum() > 200  # the others lie behind the body
    np.testing.assert_allclose(found.uv_b_px[same_point], _projected(p_G[same_point], b), atol=1e-5)
    assert found.visible[same_point].any()


@pytest.mark.parametrize("ends", [((1, 0), (1, 1)), ((3, 1), (2, 0))])
def test_there_and_back_is_the_same_pixel(
    plan: SequencePlan, caster: RayCaster, ends: tuple[tuple[int, int], tuple[int, int]]
) -> None:
    a, b = (view_of(plan, *end) for end in ends)
    there = correspond(caster, a, b, a.camera.pixel_grid())
    back = correspond(caster, b, a, there.uv_b_px[there.visible])
    assert there.visible.sum() > 1000
    assert back.visible.all()
    assert np.abs(back.uv_b_px - a.camera.pixel_grid()[there.visible]).max() < 1e-3
    np.testing.assert_allclose(back.angle_rad, there.angle_rad[there.visible], atol=1e-5)


def test_what_b_sees_first_is_what_is_called_visible(plan: SequencePlan, caster: RayCaster) -> None:
    """Visibility by the distance of b's own rays, not by the ray back to b."""
    a, b = view_of(plan, 0, 0), view_of(plan, 1, 1)
    there = correspond(caster, a, b, a.camera.pixel_grid())
    size = [b.camera.width_px - 0.5, b.camera.height_px - 0.5]
    tried = ((there.uv_b_px > -0.5) & (there.uv_b_px < size)).all(axis=-1)
    seen_from_b = correspond(caster, b, a, there.uv_b_px[tried])
    same = np.linalg.norm(seen_from_b.p_G - there.p_G[tried], axis=1) < 1e-4 * plan.body.radius_m
    assert (same != there.visible[tried]).mean() < 1e-3
    assert tried.sum() - there.visible[tried].sum() > 20


def test_a_plate_before_a_plate_hides_what_lies_on_the_line_to_it() -> None:
    """Camera b stands 0.5 m to the right of a. On the far plate, 1 m away, it cannot see x = -0.6 to -0.4 m:
    halfway stands the near plate, 0.1 m wide."""
    near = trimesh.creation.box([0.1, 0.4, 0.002])
    near.apply_translation([0.0, 0.0, -0.001])
    far = trimesh.creation.box([1.6, 0.6, 0.002])
    far.apply_translation([0.0, 0.0, 0.501])
    caster = RayCaster(assemble([Part(near, MATT), Part(far, MATT)]))
    camera, _ = build_cameras(config.Rig(width_px=320, height_px=120, focal_px=100.0))
    X_NG = make_pose(np.eye(3), [0.0, 0.0, 0.5])
    a = CameraView(camera, inverse_pose(X_NG))
    b = CameraView(camera, inverse_pose(X_NG) @ make_pose(np.eye(3), [0.5, 0.0, 0.0]))
    expected = {-0.85: False, -0.61: True, -0.59: False, -0.5: False, -0.41: False, -0.39: True, 0.05: True}
    x = np.array(list(expected))
    found = correspond(caster, a, b, np.stack([camera.K[0, 2] + 100.0 * x, np.full_like(x, 60.0)], axis=1))
    assert found.visible.tolist() == list(expected.values())
    on_far = (np.abs(x) < 0.8) & (np.abs(x) > 0.1)
    np.testing.assert_allclose(
        found.uv_b_px[on_far, 0], camera.K[0, 2] + 100.0 * (x - 0.5)[on_far], atol=1e-9
    )


def test_the_back_of_a_plate_is_turned_away_and_behind_a_camera_there_is_no_image() -> None:
    caster = RayCaster(assemble([Part(trimesh.creation.box([0.2, 0.2, 0.01]), MATT)]))
    camera, _ = build_cameras(config.Rig(width_px=64, height_px=48, focal_px=60.0))
    front = CameraView(camera, make_pose(np.eye(3), [0.0, 0.0, -0.5]))
    behind = CameraView(camera, make_pose(exp_so3([0.0, np.pi, 0.0]), [0.0, 0.0, 0.5]))
    found = correspond(caster, front, behind, camera.pixel_grid())
    on_target = np.isfinite(found.p_G[..., 0])
    assert on_target.sum() > 100 and not found.visible.any()
    assert np.isfinite(found.uv_b_px[on_target]).all()
    looks_away = CameraView(camera, make_pose(exp_so3([0.0, np.pi, 0.0]), [0.0, 0.0, -0.5]))
    found = correspond(caster, front, looks_away, np.array([[31.5, 23.5]]))
    assert not found.visible.any() and np.isnan(found.uv_b_px).all()


def test_the_lens_does_not_fold_far_points_into_the_image() -> None:
    """The polynomial of a strong barrel turns back at large angles; a point 62 degrees off is not in view."""
    plate = trimesh.creation.box([6.0, 0.2, 0.01])
    caster = RayCaster(assemble([Part(plate, MATT)]))
    straight, _ = build_cameras(config.Rig(width_px=64, height_px=48, focal_px=10.0))
    barrel, _ = build_cameras(
        config.Rig(width_px=64, height_px=48, focal_px=60.0, distortion=(-0.35, 0.04, 0.0, 0.0))
    )
    X_GK = make_pose(np.eye(3), [0.0, 0.0, -1.0])
    a, b = CameraView(straight, X_GK), CameraView(barrel, X_GK)
    uv = straight.project(np.array([[1.9, 0.0, 0.995], [0.2, 0.0, 0.995]]))
    folded = barrel.project(np.array([[1.9, 0.0, 0.995]]))
    assert 0 < folded[0, 0] < 63
    assert correspond(caster, a, b, uv).visible.tolist() == [False, True]
