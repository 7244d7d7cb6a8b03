"""The metric against finite differences and closed forms; contributions and sets of edges."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.information import FeatureInformation, contributions, variances
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    moved,
    observability,
    pose_error,
)
from polhode.planning.edges.selection import greedy, upper_bound, value_of
from polhode.planning.edges.smallest_set import SigmaLimits, min_number, smallest_set
from polhode.planning.edges.visible_edges import ControlPoints, control_points
from polhode.planning.observability.pictures import coloured_body, colours_of
from tests.planning.edges.scenes import RIG, block, information_at, poses
from tests.planning.edges.scenes import seen as information_of

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
    uv, feature, none = RIG.project(p + X[:3, 3])[:, :2], np.repeat(range(4), n), np.zeros((4 * n, 2, 3))
    points = ControlPoints(p, uv, normal, feature, np.ones(4 * n), none)
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


def test_a_cylinder_does_not_tell_the_turn_about_its_axis() -> None:
    along_y = make_pose(exp_so3([np.pi / 2 + 0.3, 0.0, 0.0]), [0.0, 0.0, 3.0])
    for sections in (24, 64, 256):
        found = seen(trimesh.creation.cylinder(0.4, 0.8, sections=sections), along_y)
        assert len(found.unobservable) == 1
        assert_allclose(np.abs(found.unobservable[0, 3:] @ along_y[:3, 2]), 1.0, atol=1e-3)
        # x is across the axis: that turn is seen
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


def test_features_add_up_to_the_metric() -> None:
    model = block()
    X = poses(3)
    total = information_at(model, X).total
    for k, pose in enumerate(X):
        points = control_points(model, RIG, pose)
        whole = observability(edge_motion(points, RIG, pose, model.centre_G), points.weight, model.radius_m)
        assert_allclose(total[k], whole.C, rtol=1e-9, atol=1e-6)
        assert_allclose(variances(total[k], model.radius_m), whole.sigma**2, rtol=1e-6)


def test_many_variances_at_once_are_infinite_where_the_metric_is() -> None:
    ball = edge_model(trimesh.creation.icosphere(3, 0.5))
    information = information_at(ball, poses(2))
    for C, each in zip(information.total, variances(information.total, ball.radius_m), strict=True):
        assert_allclose(np.sqrt(each), EdgeObservability(C, ball.radius_m, 1).sigma, rtol=1e-6)
        assert np.isinf(each[3:]).all()


def test_shares_add_up_and_do_not_depend_on_how_an_edge_is_cut() -> None:
    information = information_of(block())
    found = contributions(information)
    assert_allclose(found.share.sum(axis=0), 1.0, rtol=1e-9)
    assert (found.views == 4).all() and (found.share >= 0.0).all()
    cut = np.concatenate([information.C, 0.3 * information.C[:, :1]], axis=1)
    cut[:, 0] *= 0.7
    pieces = contributions(FeatureInformation(cut, information.radius_m)).share
    assert_allclose(pieces[0] + pieces[-1], found.share[0], rtol=1e-9)


def test_the_rise_is_the_share_of_a_small_feature_and_exact_for_a_large_one() -> None:
    information = information_of(block())
    whole = contributions(information)
    left = contributions(FeatureInformation(information.C[:, 1:], information.radius_m))
    assert_allclose(left.sigma**2 / whole.sigma**2 - 1.0, whole.rise[0], rtol=1e-6)
    small = information.C.copy()
    small[:, 0] *= 1e-4
    found = contributions(FeatureInformation(small, information.radius_m))
    assert_allclose(found.rise[0], found.share[0], rtol=2e-3)


def test_what_nothing_else_tells_rises_without_bound() -> None:
    information = information_of(block(), 1)
    kept = np.flatnonzero(information.C.trace(axis1=2, axis2=3)[0] > 0.0)
    # one after the other goes, until the next one would be missed
    while True:
        found = contributions(FeatureInformation(information.C[:, kept], information.radius_m))
        if np.isinf(found.rise).any():
            break
        kept = np.delete(kept, np.argmin(found.rise.max(axis=1)))
    assert 3 <= len(kept) <= 6 and np.isfinite(found.sigma).all()


def test_painted_edges_have_the_colours_of_the_legend(tmp_path: Path) -> None:
    model = block()
    values = np.linspace(0.0, 0.8, model.size)
    mesh, legend = coloured_body(model, values)
    assert_allclose(legend.values, [0.0, 0.2, 0.4, 0.6, 0.8])
    mesh.export(tmp_path / "painted.ply")
    back = trimesh.load_mesh(tmp_path / "painted.ply")
    assert isinstance(back.visual, trimesh.visual.ColorVisuals)
    colours = np.unique(np.asarray(back.visual.vertex_colors)[:, :3], axis=0)
    for k in range(len(model.ends_G)):
        assert (colours == colours_of(values)[0][k].astype(int)).all(axis=1).any()
    rgb, _ = colours_of(np.array([np.nan, 0.0, 1.0, np.inf]))
    assert (rgb[0] == rgb[1]).all() and (rgb[2] == rgb[3]).all() and (rgb[1] != rgb[2]).any()


def test_without_any_edge_nothing_is_shared() -> None:
    found = contributions(FeatureInformation(np.zeros((2, 3, 6, 6)), 1.0))
    assert np.isinf(found.sigma).all() and np.isnan(found.share).all() and (found.views == 0).all()
    assert found.rise.shape == pytest.approx((3, 6))


def random_information(n: int, views: int, seed: int, rank: int = 2) -> Array:
    """(views, n, 6, 6) of few lines each, some large, some small."""
    rng = np.random.default_rng(seed)
    f = rng.normal(size=(views, n, rank, 6)) * np.exp(rng.normal(size=(n, 1, 1))) * 3.0
    return np.asarray(np.einsum("tnri,tnrj->tnij", f, f))


def value(scaled: Array, features: object) -> float:
    return float(value_of(np.eye(6) + scaled[:, np.asarray(features, dtype=int)].sum(axis=1)))


@pytest.mark.parametrize(("seed", "count"), [(0, 2), (1, 4), (2, 2), (3, 4)])
def test_greedy_adds_the_best_edge_and_the_bound_holds(seed: int, count: int) -> None:
    scaled = random_information(9, 2, seed)
    best = max(value(scaled, one) for one in combinations(range(9), count))
    found = greedy(scaled, count)
    for k, feature in enumerate(found.features):
        before = found.features[:k]
        free = np.setdiff1d(range(9), before)
        assert feature == free[np.argmax([value(scaled, [*before, each]) for each in free])]
    assert found.value == pytest.approx(value(scaled, found.features))
    assert found.value <= best + 1e-9 <= upper_bound(scaled, count) + 2e-9
    assert upper_bound(scaled, 9) == pytest.approx(value(scaled, range(9)))
    # edges without information are not chosen
    scaled[:, [1, 3]] = 0.0
    assert sorted(greedy(scaled, 9).features) == [0, 2, *range(4, 9)]


def test_the_smallest_set_is_within_ten_percent_and_nearly_the_smallest() -> None:
    information = information_of(block())
    found, limits = smallest_set(information), SigmaLimits(information)
    assert found.at_least <= len(found.features) and found.ratio.max() <= 1.1
    for size in range(found.at_least, len(found.features) - 1):
        sets = combinations(limits.candidates.tolist(), size)
        assert not any(limits.meets(limits.of(list(one))) for one in sets)
    for i in found.features:
        assert not limits.meets(limits.of(found.features[found.features != i]))


def exact_size(limits: SigmaLimits) -> int:
    """Of the smallest set, by trying all."""
    for size in range(1, len(limits.candidates) + 1):
        if any(limits.meets(limits.of(list(one))) for one in combinations(limits.candidates.tolist(), size)):
            return size
    raise AssertionError


def test_the_bound_of_the_smallest_set_holds_and_more_room_needs_fewer_edges() -> None:
    for seed in range(3):
        information = FeatureInformation(random_information(10, 2, seed), 1.0)
        limits = SigmaLimits(information, 1.2)
        exact = exact_size(limits)
        assert min_number(limits) <= exact <= len(smallest_set(information, 1.2).features)
    information = information_of(block())
    sizes = [len(smallest_set(information, factor).features) for factor in (1.05, 1.3, 2.0)]
    assert sizes[0] >= sizes[1] >= sizes[2]
