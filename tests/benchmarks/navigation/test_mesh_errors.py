"""What errors of a mesh do to a pose, against poses that are fitted to the edges of another mesh."""

import numpy as np
import trimesh
from scipy.optimize import least_squares

from benchmarks.edges.views import edge_rig
from benchmarks.navigation.edge_refinement import RefinedEdges
from benchmarks.navigation.mesh_errors import covariance_of, pose_errors
from polhode.lie import Array, exp_so3, make_pose, transform_points
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.observability_metric import edge_motion, moved, pose_error
from polhode.planning.edges.visible_edges import control_points
from polhode.records import Ints

RIG = edge_rig(500.0, 400, 400)
EXTENTS = np.array([0.5, 0.4, 0.3])
X_RG = make_pose(exp_so3([0.5, -0.7, 0.3]), [0.05, -0.02, 2.0])


def box(extents: Array) -> EdgeModel:
    return edge_model(trimesh.creation.box(extents))


def known(model: EdgeModel) -> RefinedEdges:
    """Each segment is displaced as a whole, by one metre (sigma) along each axis."""
    return RefinedEdges(model, np.tile(np.eye(3), (len(model.ends_G), 2, 2)))


def fitted_pose(ends_G: Array, true_ends_G: Array, feature: Ints, p_G: Array, weight: Array) -> Array:
    """Step (6,) that moves points of displaced edges onto the images of the true ones."""
    start, end = (RIG.project(transform_points(X_RG, true_ends_G[feature, k]))[:, :2] for k in (0, 1))
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)

    def distances(step: Array) -> Array:
        uv = RIG.project(transform_points(moved(X_RG, step, np.zeros(3)), p_G))[:, :2]
        return np.asarray(np.sqrt(weight) * np.einsum("mk,mk->m", uv - start, normal))

    return np.asarray(least_squares(distances, np.zeros(6), x_scale=1e-3, xtol=1e-12).x)


def test_a_box_that_is_too_large_lies_too_far_away() -> None:
    off_m = 1e-3
    model, true = box(EXTENTS + 2.0 * off_m), box(EXTENTS)
    assert np.abs(model.ends_G - true.ends_G).max() < 1.1 * off_m
    points = control_points(model, RIG, X_RG)
    errors = pose_errors(known(model), RIG, X_RG, points, points.weight)
    step = fitted_pose(model.ends_G, true.ends_G, points.feature, points.p_G, points.weight)
    found = pose_error(moved(X_RG, step, np.zeros(3)), X_RG, np.zeros(3))
    assert found[2] > 2.0 * off_m
    assert np.abs(off_m * errors.outward - found)[:3].max() < 0.03 * found[2]
    assert np.abs(off_m * errors.outward - found)[3:].max() < 0.03 * found[2]


def test_edges_that_are_displaced_together_displace_the_pose() -> None:
    model = box(EXTENTS)
    points = control_points(model, RIG, X_RG)
    errors = pose_errors(known(model), RIG, X_RG, points, points.weight)
    assert np.linalg.eigvalsh(errors.edges).min() > 0.0
    # as all on one segment: the whole body is displaced, and the pose with it
    one = pose_errors(known(model), RIG, X_RG, points[np.zeros(40, dtype=np.int64)], np.ones(40))
    few = pose_errors(known(model), RIG, X_RG, points[np.zeros(10, dtype=np.int64)], np.ones(10))
    f = edge_motion(points[np.zeros(1, dtype=np.int64)], RIG, X_RG, model.centre_G)[0]
    for each in (one, few):
        # of the only direction that the points see, the variance is that of the place itself
        assert np.isclose(f @ each.edges @ f, f[:3] @ f[:3], rtol=1e-2)


def test_a_view_without_points_has_a_finite_covariance() -> None:
    model = box(EXTENTS)
    points = control_points(model, RIG, X_RG)
    errors = pose_errors(known(model), RIG, X_RG, points[np.zeros(0, dtype=np.int64)], np.zeros(0))
    assert np.allclose(errors.noise, covariance_of(np.zeros((6, 6)), model.radius_m))
    assert not errors.edges.any() and not errors.outward.any()
