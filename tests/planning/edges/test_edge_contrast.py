"""Contrast of edges against Lambert's law in closed form, and shadows."""

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array, make_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.visible_edges import (
    ControlPoints,
    contrast,
    contrast_weight,
    control_points,
    in_sunlight,
)
from tests.planning.edges.views import RIG, information_at


def view(eye_G: Array) -> Array:
    z = -eye_G / np.linalg.norm(eye_G)
    x = np.cross(z, [0.1, 0.2, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    return make_pose(R, -R @ eye_G)


def values_at(points: ControlPoints, found: Array, place: Array) -> Array:
    return np.asarray(found[np.linalg.norm(points.p_G - place, axis=1) < 0.06])


def test_edges_of_a_box_have_the_difference_of_its_faces() -> None:
    model = edge_model(trimesh.creation.box((1.0, 1.0, 1.0)))
    eye = np.array([3.0, 2.0, 1.5])
    points = control_points(model, RIG, view(eye))
    sun = np.array([2.0, 1.0, 2.0])
    found = contrast(model, points, eye, sun)
    # between the faces x and y, both in the light; x and z are equally bright; z against the sky
    np.testing.assert_allclose(values_at(points, found, np.array([0.5, 0.5, 0.0])), 1.0 / 3.0, atol=1e-9)
    np.testing.assert_allclose(values_at(points, found, np.array([0.5, 0.0, 0.5])), 0.0, atol=1e-9)
    np.testing.assert_allclose(values_at(points, found, np.array([-0.5, 0.0, 0.5])), 2.0 / 3.0, atol=1e-9)


def test_behind_the_body_nothing_is_lit() -> None:
    model = edge_model(trimesh.creation.box((1.0, 1.0, 1.0)))
    eye = np.array([3.0, 2.0, 1.5])
    points = control_points(model, RIG, view(eye))
    assert len(points) > 50
    assert contrast(model, points, eye, -eye).max() == 0.0
    assert len(in_sunlight(model, points, eye, -eye)) == 0
    information = information_at(model, view(eye)[None], -eye[None])
    assert not information.C.any()


def test_a_body_throws_a_shadow_on_itself() -> None:
    # a screen stands between the Sun and one end of a plate
    plate = trimesh.creation.box((2.0, 1.0, 0.2))
    screen = trimesh.creation.box((0.6, 1.4, 0.05))
    screen.apply_translation([-0.7, 0.0, 1.0])
    both = trimesh.util.concatenate([plate, screen])
    assert isinstance(both, trimesh.Trimesh)
    model = edge_model(both)
    eye = np.array([1.0, -4.0, 3.0])
    points = control_points(model, RIG, view(eye))
    found = contrast(model, points, eye, np.array([0.0, 0.0, 1.0]))
    front = np.abs(points.p_G - [0.0, -0.5, 0.1])[:, 1:].max(axis=1) < 1e-6
    x = points.p_G[:, 0]
    assert found[front & (x < -0.42) & (x > -0.98)].max() == 0.0
    assert found[front & (x > -0.38)].min() == pytest.approx(1.0)


def test_an_open_sheet_is_lit_from_behind() -> None:
    sheet = trimesh.Trimesh([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]],
                            [[0, 1, 2], [0, 2, 3]])  # fmt: skip
    model = edge_model(sheet)
    for side in -1.0, 1.0:
        eye = np.array([0.4, 0.3, 3.0 * side])
        points = control_points(model, RIG, view(eye))
        np.testing.assert_allclose(contrast(model, points, eye, np.array([0.0, 0.0, side])), 1.0)
        np.testing.assert_allclose(contrast(model, points, eye, np.array([0.0, 0.0, -side])), 0.0)


def test_the_outline_of_a_ball_is_lit_on_one_side() -> None:
    model = edge_model(trimesh.creation.icosphere(4, 0.5))
    eye, sun = np.array([0.0, 0.0, 4.0]), np.array([1.0, 0.0, 0.0])
    points = control_points(model, RIG, view(eye))
    found = contrast(model, points, eye, sun)
    expected = np.maximum(points.sides_G[:, 0] @ sun, 0.0)
    np.testing.assert_allclose(found, expected, atol=0.02)
    assert 0.3 < (found > 0.1).mean() < 0.6


def test_half_contrast_is_half_of_the_weight() -> None:
    np.testing.assert_allclose(contrast_weight(np.array([0.0, 0.1, 1.0]), 0.1), [0.0, 0.5, 1 / 1.01])
