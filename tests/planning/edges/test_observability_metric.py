"""The metric against finite differences and closed forms; contributions and sets of edges."""

from itertools import combinations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.information import (
    FeatureInformation,
    contributions,
    greedy,
    sigma_ratio,
    variances,
)
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    moved,
    observability,
    pose_error,
)
from polhode.planning.edges.visible_edges import ControlPoints, control_points
from tests.planning.edges.scenes import RIG, block, information_at, poses

X_RG = make_pose(exp_so3([0.4, 0.5, 0.2]), [0.05, 0.02, 3.0])
BOX = trimesh.creation.box((1.0, 0.6, 0.4))


def seen(mesh: trimesh.Trimesh, X: Array = X_RG) -> EdgeObservability:
    model = edge_model(mesh)
    points = control_points(model, RIG, X)
    return observability(edge_motion(points, RIG, X, model.centre_G), points.weight, model.radius_m)


def test_motion_across_edges_against_finite_differences() -> None:
    points, o_G = control_points(edge_model(BOX), RIG, X_RG), np.array([0.1, -0.2, 0.3])

    def across(step: Array) -> Array:
        uv = RIG.project(transform_points(moved(X_RG, step, o_G), points.p_G))[:, :2]
        return np.asarray(np.einsum("mk,mk->m", uv - points.uv_px, points.normal_px))

    h = 1e-5
    slopes = np.stack([(across(h * e) - across(-h * e)) / (2 * h) for e in np.eye(6)], axis=1)
    f = edge_motion(points, RIG, X_RG, o_G)
    assert np.abs(slopes - f).max() < 1e-6 * np.abs(f).max()
    step = np.array([0.01, 0.02, -0.03, 0.1, -0.2, 0.05])
    assert_allclose(pose_error(moved(X_RG, step, o_G), X_RG, o_G), step, atol=1e-12)


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


def test_a_square_face_on_has_the_closed_form() -> None:
    # Four sides of a square of half width a at distance z, n points a side of equal weight 1.
    a, z, focal, n = 0.5, 4.0, RIG.focal_px, 20
    t = (np.arange(n) + 0.5) / n * 2 * a - a
    sides = [np.stack([np.full(n, s * a), t, np.zeros(n)], axis=1) for s in (-1, 1)]
    sides += [np.stack([t, np.full(n, s * a), np.zeros(n)], axis=1) for s in (-1, 1)]
    p = np.concatenate(sides)
    normal = np.repeat([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]], n, axis=0)
    X = make_pose(np.eye(3), [0.0, 0.0, z])
    uv, feature, none = RIG.project(p + X[:3, 3])[:, :2], np.repeat(range(4), n), np.zeros((4 * n, 2, 3))
    points = ControlPoints(p, uv, normal, feature, np.ones(4 * n), none)
    C = observability(edge_motion(points, RIG, X, np.zeros(3)), points.weight, a * np.sqrt(2)).C
    # x: two sides; z: all four move by f a / z^2; about z: t^2 f^2 / z^2.
    assert C[0, 0] == pytest.approx(2 * n * (focal / z) ** 2)
    assert C[2, 2] == pytest.approx(4 * n * (focal * a / z**2) ** 2)
    assert C[5, 5] == pytest.approx(4 * (t**2).sum() * (focal / z) ** 2)
    assert_allclose(C, C.T, atol=1e-12 * C.max())


def test_a_box_tells_all_and_range_costs_depth_twice() -> None:
    found = seen(BOX)
    assert found.describe_unobservable() == ""
    assert np.isfinite(found.covariance).all() and np.isfinite(found.condition)
    assert_allclose(found.covariance @ found.C, np.eye(6), atol=1e-9)
    assert found.position_dop == pytest.approx(np.sqrt(np.trace(found.covariance[:3, :3])))
    assert found.attitude_dop == pytest.approx(np.sqrt(np.trace(found.covariance[3:, 3:])))
    near, far = (seen(BOX, make_pose(exp_so3([0.4, 0.5, 0.2]), [0, 0, z])) for z in (10.0, 20.0))
    # Half as many pixels of edge, each worth a quarter: across 2 sqrt 2; along the axis twice that.
    assert far.sigma[0] / near.sigma[0] == pytest.approx(2 * np.sqrt(2), rel=0.05)
    assert far.sigma[2] / near.sigma[2] == pytest.approx(4 * np.sqrt(2), rel=0.1)


def test_a_sphere_tells_no_rotation_a_cylinder_none_about_its_axis_one_edge_two_of_six() -> None:
    ball = seen(trimesh.creation.icosphere(4, 0.5))
    assert np.isfinite(ball.sigma[:3]).all() and np.isinf(ball.sigma[3:]).all()
    assert np.isinf([ball.condition, ball.attitude_dop, ball.geometric_dop]).all()
    said = ball.describe_unobservable()
    assert said.count("rotation") == 3 and "translation" not in said
    along_y = make_pose(exp_so3([np.pi / 2 + 0.3, 0.0, 0.0]), [0.0, 0.0, 3.0])
    for sections in (24, 256):
        found = seen(trimesh.creation.cylinder(0.4, 0.8, sections=sections), along_y)
        assert len(found.unobservable) == 1
        assert_allclose(np.abs(found.unobservable[0, 3:] @ along_y[:3, 2]), 1.0, atol=1e-3)
        # x is across the axis: that turn is seen
        assert np.isfinite(found.sigma[3])
    model = edge_model(BOX)
    feature = np.bincount(control_points(model, RIG, X_RG).feature).argmax()
    points = control_points(model.only(np.array([feature])), RIG, X_RG)
    found = observability(edge_motion(points, RIG, X_RG, model.centre_G), points.weight, model.radius_m)
    assert len(found.unobservable) == 4 and np.isinf(found.sigma).any()
    assert found.describe_unobservable().count("unobservable") == 4


def test_features_add_up_to_the_metric_and_many_variances_are_those_of_each() -> None:
    model, X = block(), poses(3)
    total = information_at(model, X).total
    for k, pose in enumerate(X):
        points = control_points(model, RIG, pose)
        whole = observability(edge_motion(points, RIG, pose, model.centre_G), points.weight, model.radius_m)
        assert_allclose(total[k], whole.C, rtol=1e-9, atol=1e-6)
        assert_allclose(variances(total[k], model.radius_m), whole.sigma**2, rtol=1e-6)
    ball = edge_model(trimesh.creation.icosphere(3, 0.5))
    total = information_at(ball, poses(2)).total
    for C, each in zip(total, variances(total, ball.radius_m), strict=True):
        assert_allclose(np.sqrt(each), EdgeObservability(C, ball.radius_m, 1).sigma, rtol=1e-6)
        assert np.isinf(each[3:]).all()


@pytest.fixture(scope="module")
def information() -> FeatureInformation:
    return information_at(block(), poses(4))


def test_shares_add_up_and_do_not_depend_on_how_an_edge_is_cut(information: FeatureInformation) -> None:
    found = contributions(information)
    assert_allclose(found.share.sum(axis=0), 1.0, rtol=1e-9)
    assert (found.views == 4).all() and (found.share >= 0.0).all()
    cut = np.concatenate([information.C, 0.3 * information.C[:, :1]], axis=1)
    cut[:, 0] *= 0.7
    pieces = contributions(FeatureInformation(cut, information.radius_m)).share
    assert_allclose(pieces[0] + pieces[-1], found.share[0], rtol=1e-9)
    none = contributions(FeatureInformation(np.zeros((2, 3, 6, 6)), 1.0))
    assert np.isinf(none.sigma).all() and np.isnan(none.share).all() and (none.views == 0).all()


def test_the_rise_is_the_share_of_a_small_feature_exact_for_a_large_one_and_inf_for_a_needed_one(
    information: FeatureInformation,
) -> None:
    whole = contributions(information)
    left = contributions(FeatureInformation(information.C[:, 1:], information.radius_m))
    assert_allclose(left.sigma**2 / whole.sigma**2 - 1.0, whole.rise[0], rtol=1e-6)
    small = information.C.copy()
    small[:, 0] *= 1e-4
    found = contributions(FeatureInformation(small, information.radius_m))
    assert_allclose(found.rise[0], found.share[0], rtol=2e-3)
    C = information.C[:1, information.C[0].any(axis=(1, 2))]
    # one after the other goes, until the next one would be missed
    while not np.isinf((found := contributions(FeatureInformation(C, information.radius_m))).rise).any():
        C = np.delete(C, np.argmin(found.rise.max(axis=1)), axis=1)
    assert 3 <= C.shape[1] <= 6 and np.isfinite(found.sigma).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_greedy_adds_the_best_edge(seed: int) -> None:
    rng = np.random.default_rng(seed)
    f = rng.normal(size=(2, 9, 2, 6)) * np.exp(rng.normal(size=(9, 1, 1))) * 3.0
    scaled = np.einsum("tnri,tnrj->tnij", f, f)
    unit = np.repeat([0.5, 1.0], 3)
    random = FeatureInformation(scaled / np.outer(unit, unit), 0.5)

    def left(features: object) -> float:
        M = np.eye(6) + scaled[:, np.asarray(features, dtype=int)].sum(axis=1)
        return float(np.trace(np.linalg.inv(M), axis1=1, axis2=2).mean())

    found = greedy(random, 4)
    for k, feature in enumerate(found):
        free = np.setdiff1d(range(9), found[:k])
        assert feature == free[np.argmin([left([*found[:k], each]) for each in free])]
    assert left(found) < 1.15 * min(left(one) for one in combinations(range(9), 4))
    # edges without information are not chosen
    random.C[:, [1, 3]] = 0.0
    assert sorted(greedy(random, 9)) == [0, 2, *range(4, 9)]


def test_the_ratio_of_sigmas_is_one_with_all_edges_and_inf_with_too_few(
    information: FeatureInformation,
) -> None:
    assert_allclose(sigma_ratio(information, np.arange(information.C.shape[1])), 1.0)
    assert np.isinf(sigma_ratio(information, greedy(information, 1))).any()
    few = greedy(information, 8)
    alone = contributions(FeatureInformation(information.C[:, few], information.radius_m)).sigma
    assert_allclose(sigma_ratio(information, few), alone / contributions(information).sigma)
    assert np.isnan(sigma_ratio(FeatureInformation(np.zeros((1, 2, 6, 6)), 1.0), np.array([0]))).all()
