"""The hull contains the body, and grows only by what is stated."""

import numpy as np
import pytest
import trimesh

from polhode.pipeline.intervals.body_hull import body_hull, hull_around
from polhode.pipeline.run_directory.summary_schema import Coverage
from polhode.records import Landmarks, SurfaceModel

BOX_M = np.array([0.3, 0.4, 0.6])
CORNERS = trimesh.creation.box(BOX_M).vertices
X = np.array([1.0, 0.0, 0.0])


def coverage(unseen: float) -> Coverage:
    return Coverage(
        seen=1.0 - unseen,
        seen_unlit=0.0,
        unseen=unseen,
        of="hull",
        unseen_direction_G=(1.0, 0.0, 0.0),
        words="",
    )


def surface(sigma_m: float) -> SurfaceModel:
    mesh = trimesh.creation.box(BOX_M)
    n = len(mesh.vertices)
    return SurfaceModel(mesh, np.full(n, sigma_m), np.full(n, 5, dtype=np.int64))


def test_a_box_has_six_sides() -> None:
    hull = hull_around(CORNERS)
    assert hull is not None and len(hull.offsets) == 6
    np.testing.assert_allclose(np.sort(hull.offsets), np.repeat(BOX_M / 2, 2), atol=1e-9)
    np.testing.assert_allclose(hull.middle, 0.0, atol=1e-12)
    assert hull.radius_m == pytest.approx(np.linalg.norm(BOX_M) / 2)


def test_points_fill_the_hull_evenly() -> None:
    hull = hull_around(CORNERS)
    assert hull is not None
    points = hull.points(160)
    assert len(points) == 160 and np.all(np.abs(points) <= BOX_M / 2 + 1e-9)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(points.std(axis=0), BOX_M / np.sqrt(12), rtol=0.03)
    np.testing.assert_array_equal(points, hull.points(160))


def test_the_sigma_of_the_surface_moves_every_side_outwards() -> None:
    hull = body_hull(surface(0.002), None, None)
    assert hull is not None
    np.testing.assert_allclose(np.sort(hull.offsets), np.repeat(BOX_M / 2, 2) + 0.006, atol=1e-9)


def test_landmarks_belong_to_the_body_once_they_are_seen_three_times() -> None:
    points = np.array([[0.2, 0.0, 0.0], [0.0, 0.5, 0.0]])
    marks = Landmarks(points, np.full(2, 1e-3), np.array([3, 2]))
    hull = body_hull(surface(0.0), marks, None)
    assert hull is not None
    assert hull.vertices.max(axis=0) == pytest.approx([0.2, 0.2, 0.3])


@pytest.mark.parametrize(("unseen", "share"), [(0.1, 0.1273), (0.2, 0.2546), (0.4, 0.5093), (0.6, 0.6667)])
def test_a_part_that_was_not_seen_extends_the_hull_towards_it(unseen: float, share: float) -> None:
    hull = body_hull(surface(0.0), None, coverage(unseen))
    assert hull is not None
    low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    np.testing.assert_allclose(low, -BOX_M / 2, atol=1e-9)
    np.testing.assert_allclose(high, BOX_M / 2 + share * BOX_M[0] * X, atol=1e-4)


def test_a_part_that_faces_all_around_extends_it_on_all_sides() -> None:
    hull = hull_around(CORNERS, 0.0, 0.25, None)
    assert hull is not None
    np.testing.assert_allclose(np.ptp(hull.vertices, axis=0), (1.0 + 0.25 * 1.08 / np.pi / 0.27) * BOX_M)


@pytest.mark.parametrize("points", [CORNERS[:3], CORNERS * [1.0, 1.0, 0.0], np.zeros((0, 3))])
def test_points_of_a_plane_have_no_hull(points: np.ndarray) -> None:
    assert hull_around(points) is None
