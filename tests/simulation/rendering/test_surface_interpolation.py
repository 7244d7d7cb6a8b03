"""Interpolation on surfaces: smooth along them, blind around their edges."""

import numpy as np

from polhode.geometry.lie import Array
from polhode.simulation.rendering.probes import SurfaceInterpolation

UP = np.array([0.0, 0.0, 1.0])


def _grid(height_m: float = 0.0) -> Array:
    x, y = (0.01 * index.ravel() for index in np.mgrid[:21, :21])
    return np.stack([x, y, np.full_like(x, height_m)], axis=1)


def _facing(normal: Array, count: int) -> Array:
    return np.tile(normal, (count, 1))


def test_an_even_field_stays_even_and_a_slope_is_followed() -> None:
    points = _grid()
    around = SurfaceInterpolation(points, _facing(UP, len(points)), 0.025)
    at = np.random.default_rng(0).uniform([0.03, 0.03, 0.0], [0.17, 0.17, 0.0], (300, 3))
    near = around.near(at, _facing(UP, 300))
    np.testing.assert_allclose(near.weight.sum(axis=1), 1.0, rtol=1e-5)
    values = np.stack([np.ones(len(points)), points[:, 0]], axis=1).astype(np.float32)
    found = near.mean(values)
    np.testing.assert_allclose(found[:, 0], 1.0, rtol=1e-5)
    np.testing.assert_allclose(found[:, 1], at[:, 0], atol=0.002)


def test_the_other_side_of_a_plate_or_a_parallel_plane_does_not_count() -> None:
    points = np.concatenate([_grid(0.0), _grid(-0.001)])
    normals = np.concatenate([_facing(UP, 441), _facing(-UP, 441)])
    around = SurfaceInterpolation(points, normals, 0.025)
    side = np.repeat([[0.0], [1.0]], 441, axis=0).astype(np.float32)
    at = _grid(0.0)[100:200]
    assert around.near(at, _facing(UP, 100)).mean(side).max() == 0.0
    assert around.near(at, _facing(-UP, 100)).mean(side).min() > 0.999
    points = np.concatenate([_grid(0.0), _grid(0.012)])
    around = SurfaceInterpolation(points, _facing(UP, 882), 0.025)
    upper = np.repeat([[0.0], [1.0]], 441, axis=0).astype(np.float32)
    assert around.near(_grid(0.0), _facing(UP, 441)).mean(upper).max() == 0.0


def test_a_place_without_points_takes_the_nearest_that_faces_the_same_half() -> None:
    points = np.concatenate([_grid(0.0), _grid(-0.01)])
    around = SurfaceInterpolation(points, np.concatenate([_facing(UP, 441), _facing(-UP, 441)]), 0.025)
    tilted = np.array([[0.98, 0.0, 0.2]])
    near = around.near(np.array([[0.1, 0.1, 0.012]]), tilted)
    assert near.weight.tolist() == [[1.0] + 11 * [0.0]]
    np.testing.assert_allclose(points[near.index[0, 0]], [0.1, 0.1, 0.0])


def test_the_nearest_is_found_or_none() -> None:
    points = _grid()
    around = SurfaceInterpolation(points, _facing(UP, 441), 0.025)
    away = np.array([[0.1, 0.1, 0.04], [9.0, 9.0, 9.0], [0.1, 0.1, 0.0]])
    facing = np.array([UP, UP, [1.0, 0.0, 0.0]])
    assert (around.nearest(away, facing) == -1).all()
    assert around.near(away, facing).mean(np.ones((441, 1), np.float32)).max() == 0.0
    points = _grid()
    around = SurfaceInterpolation(points, _facing(UP, 441), 0.025)
    found = around.nearest(points + np.array([0.002, -0.001, 0.0]), _facing(UP, 441))
    np.testing.assert_array_equal(found, np.arange(441))


def test_values_change_without_jumps() -> None:
    """A walk in steps of a hundredth of the spacing over random points: each step changes little."""
    rng = np.random.default_rng(1)
    points = rng.uniform([0, 0, 0], [0.2, 0.2, 0.0], (200, 3))
    around = SurfaceInterpolation(points, _facing(UP, 200), 0.025)
    walk = np.stack([np.linspace(0.03, 0.17, 1400), np.full(1400, 0.1), np.zeros(1400)], axis=1)
    values = rng.uniform(size=(200, 1)).astype(np.float32)
    steps = np.abs(np.diff(around.near(walk, _facing(UP, 1400)).mean(values)[:, 0]))
    assert steps.max() < 0.03
