"""What a tracker will find in a view: light on the profiles, and the accuracy that follows from them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array, make_pose
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.expected_tracking import (
    WHITE_DN,
    ExpectedLight,
    around_camera,
    expected_profiles,
    expected_tracking,
    lit_from,
)
from polhode.planning.edges.observability_metric import edge_motion, observability
from polhode.planning.edges.stripes import FLOOR_PX
from polhode.planning.edges.visible_edges import SPACING_PX, control_points
from polhode.simulation.bodies.part import join
from tests.planning.edges.pictures import BOX, POSE, RIG, bevelled_box


@pytest.fixture(scope="module")
def box() -> EdgeModel:
    return edge_model(trimesh.creation.box(BOX))


def plain_sigma(model: EdgeModel) -> Array:
    """Of the metric, for edges that are found to ``FLOOR_PX``."""
    points = control_points(model, RIG, POSE, SPACING_PX)
    f = edge_motion(points, RIG, POSE, model.centre_G)
    return FLOOR_PX * observability(f, points.weight, model.radius_m).sigma


def angle_deg(a: Array, b: Array) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b, -1.0, 1.0))))


@pytest.mark.parametrize(
    "light", [around_camera(5, 30.0), lit_from(np.array([[0.0, 0.0, -2.0], [1.0, 2.0, -2.0]]))]
)
def test_earth_and_sun_are_on_both_sides_of_the_camera(light: ExpectedLight) -> None:
    to_camera = np.array([0.0, 0.0, -1.0])
    for sun, earth in zip(light.sun_R, light.earth_R, strict=True):
        assert np.linalg.norm(sun) == pytest.approx(1.0) and angle_deg(sun, earth) == pytest.approx(100.0)
        assert angle_deg(sun, to_camera) + angle_deg(to_camera, earth) == pytest.approx(100.0)


def test_profiles_of_a_box_are_lit_by_lambert(box: EdgeModel) -> None:
    points = control_points(box, RIG, POSE, SPACING_PX)
    sun = np.array([0.3, -0.5, -0.8])
    grey = expected_profiles(box, points, RIG, POSE, lit_from(sun, earth=0.0))[0]
    normals = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) @ POSE[:3, :3].T
    levels = np.append(WHITE_DN * np.maximum(normals @ (sun / np.linalg.norm(sun)), 0.0), 0.0)
    # both ends of a profile show a face of the box or the sky, but where it crosses a corner
    ends = grey[:, [0, -1]]
    off = np.abs(ends[:, :, None] - levels).min(axis=2)
    assert np.median(off) < 0.3 and np.mean(off < 1.0) > 0.8


def test_of_a_box_in_good_light_it_is_the_metric(box: EdgeModel) -> None:
    found = expected_tracking(box, RIG, POSE)
    ratio = found.sigma / plain_sigma(box)
    # the noise of the image comes on top of the floor
    assert (ratio > 1.0).all() and (ratio < 2.0).all()
    assert (np.abs(found.displacement) < 0.5 * found.sigma).all()


def test_a_larger_floor_makes_edges_as_much_worse(box: EdgeModel) -> None:
    one, other = (expected_tracking(box, RIG, POSE, floor_px=each) for each in (0.05, 0.5))
    ratio = np.sqrt(np.diagonal(other.information.covariance) / np.diagonal(one.information.covariance))
    # the smaller one is smaller than the noise of the image
    assert (ratio > 5.0).all() and (ratio < 10.0).all()


def test_an_edge_between_faces_that_are_equally_light_tells_nothing(box: EdgeModel) -> None:
    # the bisector of the three faces that are seen: their common edges have no contrast, outlines have
    facing = np.sign((POSE[:3, :3] @ np.diag([1.0, 1.0, 1.0]))[2])
    sun = -(POSE[:3, :3] @ facing)
    even, uneven = (
        expected_tracking(box, RIG, POSE, lit_from(each)) for each in (sun, np.array([0.5, -0.2, -1.0]))
    )
    assert (even.sigma[3:] > 1.1 * uneven.sigma[3:]).all()


def test_in_the_dark_nothing_is_told(box: EdgeModel) -> None:
    dark = expected_tracking(box, RIG, POSE, lit_from(np.array([0.1, 0.0, 1.0]), earth=0.0))
    assert not np.isfinite(dark.sigma).any()


def test_a_bevel_costs_accuracy_and_edges_that_are_not_used_disturb(box: EdgeModel) -> None:
    bevelled = edge_model(bevelled_box(BOX, 0.004))
    assert (expected_tracking(bevelled, RIG, POSE).sigma > expected_tracking(box, RIG, POSE).sigma).all()
    half = bevelled.only(np.arange(0, len(bevelled.ends_G), 2))
    disturbed, known = (expected_tracking(half, RIG, POSE, known=each) for each in (None, bevelled))
    assert np.linalg.norm(disturbed.sigma / known.sigma) > np.sqrt(6.0)


def test_what_the_model_lacks_displaces_the_pose(box: EdgeModel) -> None:
    # a ridge along an edge of the box, which the model does not have, casts its shadow beside it
    ridge = trimesh.creation.box((0.9 * BOX[0], 0.012, 0.03))
    ridge.apply_translation([0.0, 0.5 * BOX[1] - 0.03, -0.5 * BOX[2]])
    whole = edge_model(join([trimesh.creation.box(BOX), ridge]))
    blind = replace(
        box, surface=whole.surface, occluder=whole.occluder, corner_normals_G=whole.corner_normals_G
    )
    clean = expected_tracking(box, RIG, POSE)
    disturbed = expected_tracking(blind, RIG, POSE)
    sigma = np.sqrt(np.diagonal(clean.information.covariance))
    assert np.abs(disturbed.displacement / sigma).max() > 3.0 * np.abs(clean.displacement / sigma).max()


def test_no_edges_tell_nothing(box: EdgeModel) -> None:
    away = make_pose(np.eye(3), [50.0, 0.0, 3.0])
    found = expected_tracking(box, RIG, away)
    assert "no edge is visible" in found.information.describe_unobservable()
    assert not np.isfinite(found.sigma).any()
