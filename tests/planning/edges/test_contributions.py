"""Contributions of edges: they add up, they are the rise to first order, they are painted."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.information import (
    FeatureInformation,
    contributions,
    variances,
)
from polhode.planning.edges.observability_metric import EdgeObservability, edge_motion, observability
from polhode.planning.edges.visible_edges import control_points
from polhode.planning.observability.pictures import coloured_body, colours_of
from tests.planning.edges.views import RIG, block, information_at, poses, seen


def test_features_add_up_to_the_metric() -> None:
    model = block()
    X = poses(3)
    total = information_at(model, X).total
    for k, pose in enumerate(X):
        points = control_points(model, RIG, pose)
        whole = observability(edge_motion(points, RIG, pose, model.centre_G), points.weight, model.radius_m)
        np.testing.assert_allclose(total[k], whole.C, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(variances(total[k], model.radius_m), whole.sigma**2, rtol=1e-6)


def test_many_variances_at_once_are_infinite_where_the_metric_is() -> None:
    ball = edge_model(trimesh.creation.icosphere(3, 0.5))
    information = information_at(ball, poses(2))
    for C, each in zip(information.total, variances(information.total, ball.radius_m), strict=True):
        np.testing.assert_allclose(np.sqrt(each), EdgeObservability(C, ball.radius_m, 1).sigma, rtol=1e-6)
        assert np.isinf(each[3:]).all()


def test_shares_add_up_and_do_not_depend_on_how_an_edge_is_cut() -> None:
    information = seen(block())
    found = contributions(information)
    np.testing.assert_allclose(found.share.sum(axis=0), 1.0, rtol=1e-9)
    assert (found.views == 4).all() and (found.share >= 0.0).all()
    cut = np.concatenate([information.C, 0.3 * information.C[:, :1]], axis=1)
    cut[:, 0] *= 0.7
    pieces = contributions(FeatureInformation(cut, information.radius_m)).share
    np.testing.assert_allclose(pieces[0] + pieces[-1], found.share[0], rtol=1e-9)


def test_the_rise_is_the_share_of_a_small_feature_and_exact_for_a_large_one() -> None:
    information = seen(block())
    whole = contributions(information)
    left = contributions(FeatureInformation(information.C[:, 1:], information.radius_m))
    np.testing.assert_allclose(left.sigma**2 / whole.sigma**2 - 1.0, whole.rise[0], rtol=1e-6)
    small = information.C.copy()
    small[:, 0] *= 1e-4
    found = contributions(FeatureInformation(small, information.radius_m))
    np.testing.assert_allclose(found.rise[0], found.share[0], rtol=2e-3)


def test_what_nothing_else_tells_rises_without_bound() -> None:
    information = seen(block(), 1)
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
    np.testing.assert_allclose(legend.values, [0.0, 0.2, 0.4, 0.6, 0.8])
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
