"""Views for trials of edge trackers: where the body is, what is lit, what the seeds determine."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from benchmarks.edges.views import (
    NAMES,
    SOLIDS,
    EdgeViews,
    ViewOptions,
    edge_body,
    edge_rig,
    extruded,
    lights_to_camera,
    middle,
    perturbed,
    pose_errors,
    random_poses,
    random_rotation,
    random_suns,
)
from polhode.config.scene_settings import Sensor
from polhode.errors import InputError
from polhode.images import Grey
from polhode.lie import Array, exp_so3, make_pose, transform_points

RIG = edge_rig(focal_px=200.0, width_px=160, height_px=120)
BRIGHT_DN = 10


@pytest.fixture(scope="module")
def views() -> EdgeViews:
    return EdgeViews(edge_body("block"), RIG, 1)


@pytest.fixture(scope="module")
def poses() -> Array:
    return random_poses(edge_body("block").mesh, RIG, 6, seed=1)


def test_the_body_is_where_its_mesh_projects_to(poses: Array) -> None:
    # A blurred rim is wider on the bright side.
    views = EdgeViews(edge_body("block"), RIG, 1, ViewOptions(sensor=Sensor(blur_px=0.0)))
    for k, (X_CG, sun_C) in enumerate(zip(poses, random_suns(6, seed=2), strict=True)):
        image = views.image(X_CG, sun_C, k)
        assert image.shape == (120, 160) and image.dtype == np.uint8
        uv = RIG.project(transform_points(X_CG, views.target.mesh.vertices))[:, :2].astype(np.float32)
        # the block is convex: its outline is the hull of its corners
        hull = cv2.convexHull(uv)
        outline = cv2.moments(hull)
        middle_px = np.array([outline["m10"], outline["m01"]]) / outline["m00"]
        v, u = np.nonzero(image > BRIGHT_DN)
        np.testing.assert_allclose([u.mean(), v.mean()], middle_px, atol=0.3)
        # pixels that the outline passes through are lit, on both sides of it
        assert 0.0 < len(u) - outline["m00"] < cv2.arcLength(hull, True)


def test_a_view_is_the_same_in_any_order_and_its_noise_is_its_own(views: EdgeViews, poses: Array) -> None:
    suns = random_suns(2, seed=2)
    both = views.images(poses[:2], suns)
    assert np.array_equal(views.image(poses[1], suns[1], 1), both[1])
    again = views.image(poses[1], suns[1], 7)
    difference = again.astype(int) - both[1]
    assert difference.any() and np.abs(difference).max() < 20


def test_the_side_towards_the_sun_is_bright_and_the_earth_fills_the_other(views: EdgeViews) -> None:
    X_CG = make_pose(exp_so3([0.0, np.deg2rad(45.0), 0.0]), [0.0, 0.0, 2.0])
    from_right, from_left = (views.image(X_CG, np.array([x, 0.0, -0.7])) for x in (1.0, -1.0))
    columns = np.arange(160)

    def weight(image: Grey) -> float:
        return float((image @ columns).sum() / image.sum())

    assert weight(from_right) > weight(from_left) + 2.0
    dark = EdgeViews(views.target, RIG, 1, ViewOptions(earth=0.0)).image(X_CG, np.array([1.0, 0.0, 0.2]))
    lit = views.image(X_CG, np.array([1.0, 0.0, 0.2]))
    assert (lit > BRIGHT_DN).sum() > 1.3 * (dark > BRIGHT_DN).sum()


def test_the_lights_stand_on_either_side_of_the_camera() -> None:
    for sun_C in [*random_suns(20, seed=3), np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 2.0])]:
        R_CN = lights_to_camera(sun_C)
        np.testing.assert_allclose(R_CN.T @ R_CN, np.eye(3), atol=1e-12)
        assert np.linalg.det(R_CN) == pytest.approx(1.0)
        np.testing.assert_allclose(R_CN[:, 2], sun_C / np.linalg.norm(sun_C), atol=1e-12)
        assert R_CN[2, 0] <= 1e-12


def test_suns_shine_from_the_cameras_side() -> None:
    cosine = -random_suns(500, seed=1, within_deg=(20.0, 75.0))[:, 2]
    assert np.cos(np.deg2rad(75.0)) <= cosine.min() < 0.3
    assert 0.9 < cosine.max() <= np.cos(np.deg2rad(20.0))


def test_poses_keep_the_body_in_view_at_the_range_asked_for() -> None:
    mesh, rig = edge_body("ell").mesh, edge_rig()
    poses = random_poses(mesh, rig, 100, seed=5, range_m=(2.0, 4.0))
    ranges = (poses[:, :3, :3] @ middle(mesh) + poses[:, :3, 3])[:, 2]
    assert 2.0 <= ranges.min() < 2.2 and 3.8 < ranges.max() <= 4.0
    uv = np.vstack([rig.project(transform_points(X, mesh.vertices))[:, :2] for X in poses])
    assert (uv > 0).all() and (uv < [rig.width_px, rig.height_px]).all()


def test_rotations_are_even_over_all() -> None:
    rng = np.random.default_rng(0)
    R = np.array([random_rotation(rng) for _ in range(4000)])
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    # of even rotations, entries have mean zero and variance 1/3
    assert np.abs(R.mean(axis=0)).max() < 0.04
    assert np.abs(R.var(axis=0) - 1.0 / 3.0).max() < 0.03


def test_errors_are_those_that_were_put_in() -> None:
    about_G = np.array([0.3, -0.1, 0.2])
    X_CG = random_poses(edge_body("wedge").mesh, RIG, 2000, seed=1)
    errors = pose_errors(perturbed(X_CG, about_G, seed=4, angle_deg=2.0, shift_m=0.02), X_CG, about_G)
    np.testing.assert_allclose(errors[:, :3].std(axis=0), 0.02, rtol=0.06)
    np.testing.assert_allclose(np.rad2deg(errors[:, 3:].std(axis=0)), 2.0, rtol=0.06)
    # turned about the point: the errors of place and attitude have nothing to do with each other
    assert np.abs(np.corrcoef(errors.T) - np.eye(6)).max() < 0.08
    shifted = X_CG[:1].copy()
    shifted[0, 2, 3] += 0.1
    np.testing.assert_allclose(pose_errors(shifted, X_CG[:1], about_G), [[0, 0, 0.1, 0, 0, 0]], atol=1e-12)


@pytest.mark.parametrize("name", [name for name in SOLIDS if name != "satellite"])
def test_solids_are_closed_and_around_their_middle(name: str) -> None:
    mesh = SOLIDS[name]()
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.05
    assert np.abs(middle(mesh)).max() < 0.06
    assert 0.6 < np.ptp(mesh.vertices, axis=0).max() < 1.6


def test_an_extruded_outline_has_the_volume_of_its_outline() -> None:
    square = extruded([[0, 0], [2, 0], [2, 1], [0, 1]], [0.4, 0.3], 3.0)
    assert square.is_watertight
    assert square.volume == pytest.approx(6.0)


def test_a_plain_body_has_the_shape_of_the_rich_one_and_one_grey() -> None:
    plain, rich = edge_body("cubesat"), edge_body("cubesat", plain=False)
    np.testing.assert_array_equal(plain.mesh.vertices, rich.mesh.vertices)
    assert len(plain.body.materials) == 1 < len(rich.body.materials)
    X_CG = random_poses(plain.mesh, RIG, 1, seed=1)[0]
    images = [EdgeViews(body, RIG, 1).image(X_CG, np.array([0.5, 0.0, -1.0])) for body in (plain, rich)]
    assert all((image > BRIGHT_DN).sum() > 100 for image in images)
    assert not np.array_equal(images[0], images[1])


def test_bodies_come_from_meshes_and_files(tmp_path: Path) -> None:
    box = trimesh.creation.box([0.5, 0.4, 0.3])
    box.export(tmp_path / "box.ply")
    from_mesh, from_file = edge_body(box), edge_body(tmp_path / "box.ply")
    assert from_file.name == "box"
    X_CG = make_pose(np.eye(3), [0.0, 0.0, 2.0])
    images = [
        EdgeViews(body, RIG, 1).image(X_CG, np.array([0.0, 0.5, -1.0])) for body in (from_mesh, from_file)
    ]
    assert np.array_equal(images[0], images[1])
    with pytest.raises(InputError, match="no such body; choose from block, wedge"):
        edge_body("bock")
    assert len(NAMES) == len(set(NAMES)) >= 10


def test_scattered_rays_give_the_same_image_twice_and_the_same_body(poses: Array) -> None:
    sun_C = random_suns(1, seed=2)[0]
    rows, scattered = (
        EdgeViews(edge_body("block"), RIG, 1, ViewOptions(scattered=s)).image(poses[0], sun_C).astype(float)
        for s in (False, True)
    )
    again = EdgeViews(edge_body("block"), RIG, 1, ViewOptions(scattered=True)).image(poses[0], sun_C)
    assert np.array_equal(again, scattered)
    # only pixels that an edge passes differ
    assert 0.0 < np.mean(np.abs(rows - scattered) > 15.0) < 0.02
    assert scattered.sum() == pytest.approx(rows.sum(), rel=0.01)
