"""The edge tracker on drawn images, and what it says when it cannot."""

import numpy as np
import pytest
import trimesh

from benchmarks.edges.tracking.tracker import TrackerOptions, track
from polhode.lie import Array, make_pose
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.observability_metric import edge_motion, moved, observability, pose_error
from polhode.planning.edges.visible_edges import SPACING_PX, clear_points
from tests.planning.edges.pictures import BOX, POSE, RIG, drawn


@pytest.fixture(scope="module")
def box() -> EdgeModel:
    return edge_model(trimesh.creation.box(BOX))


@pytest.fixture(scope="module")
def image(box: EdgeModel) -> Array:
    return drawn(box.surface, POSE)


@pytest.mark.parametrize("seed", range(6))
def test_a_pose_that_is_a_little_off_is_mended(box: EdgeModel, image: Array, seed: int) -> None:
    rng = np.random.default_rng(seed)
    step = np.concatenate([0.01 * rng.standard_normal(3), np.deg2rad(1.0) * rng.standard_normal(3)])
    found = track(box, RIG, image, moved(POSE, step, box.centre_G))
    error = np.abs(pose_error(found.X_RG, POSE, box.centre_G))
    assert found.converged and found.reason == ""
    assert found.found_share > 0.95 and found.sigma_px < 0.15
    # 0.1 px at 2.5 m; depth and turns through the metric
    assert (error < 0.15 * found.information.sigma).all()


def test_with_unit_weights_its_information_is_the_metric(box: EdgeModel, image: Array) -> None:
    found = track(box, RIG, image, POSE)
    points = clear_points(box, RIG, found.X_RG, SPACING_PX)
    f = edge_motion(points, RIG, found.X_RG, box.centre_G)
    alone = observability(f, points.weight, box.radius_m)
    unweighted = observability(found.f, found.points.weight, box.radius_m)
    weighted = observability(found.f, found.points.weight * found.robust, box.radius_m)
    assert np.allclose(weighted.C, found.C, rtol=1e-12)
    # the tracker keeps its points while they move by less than a pixel
    assert np.allclose(unweighted.C, alone.C, rtol=0.02, atol=1e-3 * np.abs(alone.C).max())
    full = TrackerOptions(ranges_px=(4.0,), iterations=0)
    first = track(box, RIG, image, POSE, full)
    assert np.allclose(
        observability(first.f, first.points.weight, box.radius_m).C,
        _metric_at(box, POSE),
        rtol=1e-12,
        atol=1e-9,
    )


def _metric_at(model: EdgeModel, X_RG: Array) -> Array:
    points = clear_points(model, RIG, X_RG, SPACING_PX)
    f = edge_motion(points, RIG, X_RG, model.centre_G)
    return observability(f, points.weight, model.radius_m).C


def test_the_covariance_is_that_of_repeated_noise_where_contrast_is_even(box: EdgeModel) -> None:
    clean = drawn(box.surface, POSE, noise=0.0, lit=0.0)
    errors = []
    for seed in range(40):
        noisy = clean + 2.0 * np.random.default_rng(seed).standard_normal(clean.shape)
        found = track(box, RIG, noisy, POSE)
        errors.append(pose_error(found.X_RG, POSE, box.centre_G) / np.sqrt(np.diagonal(found.covariance)))
    spread = np.std(errors, axis=0)
    # To a factor of about two: residuals hold what is common to an edge, too.
    assert (spread > 0.4).all() and (spread < 2.0).all()


def test_a_target_behind_the_camera_is_said(box: EdgeModel, image: Array) -> None:
    found = track(box, RIG, image, make_pose(np.eye(3), [0.0, 0.0, -2.0]))
    assert not found.converged and found.reason == "the target is behind the camera"
    assert np.isinf(found.information.sigma).all()


def test_a_target_beside_the_image_is_said(box: EdgeModel, image: Array) -> None:
    found = track(box, RIG, image, make_pose(np.eye(3), [9.0, 0.0, 2.0]))
    assert not found.converged and found.reason == "no edge is in sight"


def test_an_empty_image_is_said(box: EdgeModel) -> None:
    found = track(box, RIG, np.zeros((480, 640)), POSE)
    assert not found.converged and "too few for a pose" in found.reason
    assert found.found_share == 0.0 and np.isinf(found.sigma_px)


def test_a_sphere_gives_its_place_and_says_that_turns_are_not_seen() -> None:
    ball = edge_model(trimesh.creation.icosphere(4, 0.4))
    picture = drawn(ball.surface, POSE)
    found = track(ball, RIG, picture, moved(POSE, np.array([0.01, -0.008, 0.02, 0, 0, 0]), ball.centre_G))
    assert found.converged and "rotation about" in found.reason
    assert np.isinf(found.information.sigma[3:]).all()
    assert (np.abs(pose_error(found.X_RG, POSE, ball.centre_G)[:3]) < [5e-4, 5e-4, 4e-3]).all()


def test_one_edge_says_what_it_does_not_tell(box: EdgeModel, image: Array) -> None:
    points = clear_points(box, RIG, POSE, SPACING_PX)
    longest = int(np.bincount(points.feature).argmax())
    found = track(box.only(np.array([longest])), RIG, image, POSE, TrackerOptions(min_found=6))
    assert found.converged and found.reason.count("unobservable") == 4
    assert np.isinf(found.information.sigma).any()
