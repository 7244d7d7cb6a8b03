"""The metric against finite differences, closed forms, and bodies that cannot tell all of their pose."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    moved,
    observability,
    pose_error,
)
from polhode.planning.edges.visible_edges import ControlPoints, control_points

RIG = RectifiedRig(800.0, 319.5, 239.5, 0.1, 640, 480)
X_RG = make_pose(exp_so3([0.4, 0.5, 0.2]), [0.05, 0.02, 3.0])


def seen(mesh: trimesh.Trimesh, X: Array = X_RG) -> EdgeObservability:
    model = edge_model(mesh)
    points = control_points(model, RIG, X)
    return observability(edge_motion(points, RIG, X, model.centre_G), points.weight, model.radius_m)


def test_motion_across_edges_against_finite_differences() -> None:
    model = edge_model(trimesh.creation.box((1.0, 0.6, 0.4)))
    points, o_G = control_points(model, RIG, X_RG), np.array([0.1, -0.2, 0.3])

    def across(step: Array) -> Array:
        uv = RIG.project(transform_points(moved(X_RG, step, o_G), points.p_G))[:, :2]
        return np.asarray(np.einsum("mk,mk->m", uv - points.uv_px, points.normal_px))

    h = 1e-5
    slopes = np.stack([(across(h * e) - across(-h * e)) / (2 * h) for e in np.eye(6)], axis=1)
    f = edge_motion(points, RIG, X_RG, o_G)
    assert np.abs(slopes - f).max() < 1e-6 * np.abs(f).max()


def test_an_outline_moves_as_the_material_point_does() -> None:
    # The outline slides over a smooth body; across itself it moves as if it did not.
    model = edge_model(trimesh.creation.icosphere(5, 0.5))
    points = control_points(model, RIG, X_RG)
    f = edge_motion(points, RIG, X_RG, np.zeros(3))
    step = np.array([2e-3, -1e-3, 4e-3, 0.0, 0.0, 0.0])
    after = control_points(model, RIG, moved(X_RG, step, np.zeros(3)))
    # The new outline, an ellipse of many points, at the old points' normals.
    gap = after.uv_px[None] - points.uv_px[:, None]
    along = np.abs(gap[..., 0] * points.normal_px[:, None, 1] - gap[..., 1] * points.normal_px[:, None, 0])
    across = np.einsum("mnk,mk->mn", gap, points.normal_px)
    nearest = np.argmin(along + 1e3 * (np.abs(across) > 20), axis=1)
    offset = across[np.arange(len(points)), nearest]
    close = along[np.arange(len(points)), nearest] < 1.0
    assert close.sum() > 10
    assert_allclose(offset[close], (f @ step)[close], atol=0.05)


def test_steps_and_errors_are_inverse() -> None:
    o_G, step = np.array([0.1, -0.2, 0.3]), np.array([0.01, 0.02, -0.03, 0.1, -0.2, 0.05])
    assert_allclose(pose_error(moved(X_RG, step, o_G), X_RG, o_G), step, atol=1e-12)


def test_a_square_face_on_has_the_closed_form() -> None:
    # Four sides of a square of half width a at distance z, n points a side of equal weight 1.
    a, z, focal = 0.5, 4.0, RIG.focal_px
    n = 20
    t = (np.arange(n) + 0.5) / n * 2 * a - a
    sides = [np.stack([np.full(n, s * a), t, np.zeros(n)], axis=1) for s in (-1, 1)]
    sides += [np.stack([t, np.full(n, s * a), np.zeros(n)], axis=1) for s in (-1, 1)]
    p = np.concatenate(sides)
    normal = np.repeat([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]], n, axis=0)
    X = make_pose(np.eye(3), [0.0, 0.0, z])
    points = ControlPoints(
        p,
        RIG.project(p + X[:3, 3])[:, :2],
        normal,
        np.repeat(range(4), n),
        np.ones(4 * n),
        np.zeros((4 * n, 2, 3)),
    )
    C = observability(edge_motion(points, RIG, X, np.zeros(3)), points.weight, a * np.sqrt(2)).C
    # x: two sides; z: all four move by f a / z^2; about z: t^2 f^2 / z^2.
    assert C[0, 0] == pytest.approx(2 * n * (focal / z) ** 2)
    assert C[2, 2] == pytest.approx(4 * n * (focal * a / z**2) ** 2)
    assert C[5, 5] == pytest.approx(4 * (t**2).sum() * (focal / z) ** 2)
    assert_allclose(C, C.T)


def test_a_box_tells_all() -> None:
    found = seen(trimesh.creation.box((1.0, 0.6, 0.4)))
    assert found.describe_unobservable() == ""
    assert np.isfinite(found.covariance).all() and np.isfinite(found.condition)
    assert_allclose(found.covariance @ found.C, np.eye(6), atol=1e-9)
    assert found.position_dop == pytest.approx(np.sqrt(np.trace(found.covariance[:3, :3])))
    assert found.attitude_dop == pytest.approx(np.sqrt(np.trace(found.covariance[3:, 3:])))


def test_range_costs_depth_twice() -> None:
    near, far = (
        seen(trimesh.creation.box((1.0, 0.6, 0.4)), make_pose(exp_so3([0.4, 0.5, 0.2]), [0, 0, z]))
        for z in (10.0, 20.0)
    )
    # Half as many pixels of edge, each worth a quarter: across 2 sqrt 2; along the axis twice that.
    assert far.sigma[0] / near.sigma[0] == pytest.approx(2 * np.sqrt(2), rel=0.05)
    assert far.sigma[2] / near.sigma[2] == pytest.approx(4 * np.sqrt(2), rel=0.1)


def test_a_sphere_tells_no_turn() -> None:
    found = seen(trimesh.creation.icosphere(4, 0.5))
    assert np.isfinite(found.sigma[:3]).all()
    assert np.isinf(found.sigma[3:]).all()
    assert np.isinf(found.condition) and np.isinf(found.attitude_dop) and np.isinf(found.geometric_dop)
    assert (
        found.describe_unobservable().count("rotation") == 3
        and "translation" not in found.describe_unobservable()
    )


@pytest.mark.parametrize("sections", [24, 64, 256])
def test_a_cylinder_does_not_tell_the_turn_about_its_axis(sections: int) -> None:
    along_y = make_pose(exp_so3([np.pi / 2 + 0.3, 0.0, 0.0]), [0.0, 0.0, 3.0])
    found = seen(trimesh.creation.cylinder(0.4, 0.8, sections=sections), along_y)
    assert len(found.unobservable) == 1
    axis = along_y[:3, 2]
    assert_allclose(np.abs(found.unobservable[0, 3:] @ axis), 1.0, atol=1e-3)
    # x is across the axis: that turn is seen.
    assert np.isfinite(found.sigma[3])


def test_one_edge_tells_two_of_six() -> None:
    model = edge_model(trimesh.creation.box((1.0, 0.6, 0.4)))
    whole = control_points(model, RIG, X_RG)
    feature = np.bincount(whole.feature).argmax()
    points = control_points(model.only(np.array([feature])), RIG, X_RG)
    found = observability(edge_motion(points, RIG, X_RG, model.centre_G), points.weight, model.radius_m)
    assert len(found.unobservable) == 4
    assert np.isinf(found.sigma).any()
    assert found.describe_unobservable().count("unobservable") == 4
