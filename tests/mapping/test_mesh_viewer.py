"""The mesh in a camera against closed form: silhouettes, depths, interpolated values."""

import numpy as np
import pytest
import trimesh

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import exp_so3, inverse_pose, make_pose, transform_points
from polhode.mapping.visibility import MeshViewer

RIG = RectifiedRig(200.0, 63.5, 47.5, 0.1, 128, 96)
COLUMNS, ROWS = np.arange(128.0), np.arange(96.0)
EDGE_M, DISTANCE_M = 0.2, 0.9


def box() -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.box((EDGE_M, EDGE_M, EDGE_M))
    return mesh


def ray_directions() -> np.ndarray:
    u, v = np.meshgrid(COLUMNS, ROWS)
    return np.stack(
        [(u - RIG.cx_px) / RIG.focal_px, (v - RIG.cy_px) / RIG.focal_px, np.ones_like(u)], axis=-1
    )


def test_a_box_seen_head_on_is_a_square_at_the_depth_of_its_face() -> None:
    X_RG = make_pose(np.eye(3), [0.0, 0.0, DISTANCE_M])
    view = MeshViewer(box()).perspective(RIG, X_RG, COLUMNS, ROWS)
    depth = DISTANCE_M - EDGE_M / 2
    half = EDGE_M / 2
    ray = ray_directions()
    expected = (np.abs(ray[..., 0] * depth) <= half) & (np.abs(ray[..., 1] * depth) <= half)
    np.testing.assert_array_equal(view.hit, expected)
    np.testing.assert_allclose(view.depth_m[view.hit], depth, rtol=1e-12)
    assert view.front.all()
    # through a hole the inner side is distinguished from the outer
    mesh = box()
    mesh.update_faces(mesh.face_normals[:, 2] > -0.5)  # the side towards the camera is open
    view = MeshViewer(mesh).perspective(RIG, make_pose(np.eye(3), [0, 0, DISTANCE_M]), COLUMNS, ROWS)
    assert view.hit.any() and not view.front.any()
    # an empty mesh is nowhere seen
    nothing = trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), process=False)
    view = MeshViewer(nothing).perspective(RIG, make_pose(np.eye(3), [0, 0, 1]), COLUMNS, ROWS)
    assert not view.hit.any()
    assert not view.values(np.zeros(0)).any()


def test_a_sphere_has_the_depths_of_the_quadratic_equation() -> None:
    radius, centre = 0.15, np.array([0.05, -0.02, DISTANCE_M])
    X_RG = make_pose(exp_so3([0.3, -0.8, 1.1]), centre)
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    view = MeshViewer(ball).perspective(RIG, X_RG, COLUMNS, ROWS)
    ray = ray_directions()
    a, b, c = (ray**2).sum(-1), ray @ centre, centre @ centre - radius**2
    root = b**2 - a * c
    # At the limb the polyhedron is a little smaller than the ball.
    assert (view.hit & (root < 0.0)).sum() == 0
    assert ((root > 0.0) & ~view.hit).sum() < 0.02 * view.hit.sum()
    expected = (b - np.sqrt(np.maximum(root, 0.0))) / a
    inner = view.hit & (root > 0.1 * root.max())
    np.testing.assert_allclose(view.depth_m[inner], expected[inner], atol=3e-4)


@pytest.mark.parametrize("distance_m", [0.5, 2000.0])
def test_values_are_those_of_the_point_that_is_seen(distance_m: float) -> None:
    """Coordinates as values of the vertices: interpolation gives back the point, also from far away."""
    rig = RectifiedRig(200.0 * distance_m, 63.5, 47.5, 0.1, 128, 96)
    X_RG = make_pose(exp_so3([0.4, 0.5, -0.2]), [0.01, 0.0, distance_m])
    mesh = box().subdivide()
    view = MeshViewer(mesh).perspective(rig, X_RG, COLUMNS + 2.0, ROWS)
    u, v = np.meshgrid(COLUMNS + 2.0, ROWS)
    ray = np.stack([(u - 63.5) / rig.focal_px, (v - 47.5) / rig.focal_px, np.ones_like(u)], axis=-1)
    point_G = transform_points(inverse_pose(X_RG), (ray * view.depth_m[..., None])[view.hit])
    assert view.hit.sum() > 500
    np.testing.assert_allclose(view.values(mesh.vertices)[view.hit], point_G, atol=1e-6)
    np.testing.assert_allclose(np.abs(point_G).max(axis=1), EDGE_M / 2, atol=1e-6)


def test_parallel_rays_see_the_true_size_and_the_depth_from_the_plane_through_the_centre() -> None:
    centre = np.array([0.02, 0.0, 0.0])
    view = MeshViewer(box()).orthographic(centre, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], 0.15, 300)
    assert view.hit.sum() == 200 * 200
    # The eye stands at +x: the face at x = 0.1 is 0.08 in front of the plane.
    np.testing.assert_allclose(view.depth_m[view.hit], -0.08, atol=1e-9)
    upward = view.values(box().vertices[:, 2])
    assert upward[60, 150] > 0.0 > upward[240, 150]
