"""Hull, centres of mass and inertia ratios that hull and motion admit, of bodies whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array, exp_so3
from polhode.pipeline.intervals.hull_and_limits import (
    BodyHull,
    MotionLimits,
    body_hull,
    com_extremes,
    farthest_com,
    hull_around,
)
from polhode.pipeline.intervals.inertia_ratios import RatioIntervals, ratio_intervals
from polhode.records.estimate import Landmarks
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Coverage

BOX_M = np.array([0.3, 0.4, 0.6])
CORNERS = trimesh.creation.box(BOX_M).vertices


def spin_limits(axis: int = 2, com_G: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> MotionLimits:
    """A steady spin about an axis of G: free is a shift along it; it is a principal axis."""
    margin, rows = np.zeros(3), np.zeros((2, 6))
    margin[axis] = 10.0
    # the products of inertia with this axis, among xy, xz, yz
    products = [n for n, pair in enumerate(((0, 1), (0, 2), (1, 2))) if axis in pair]
    rows[[0, 1], [3 + n for n in products]] = 1.0
    return MotionLimits(np.array(com_G), np.eye(3), margin, np.concatenate([rows, -rows]), np.eye(3))


def no_limits() -> MotionLimits:
    """A target at rest: everything is free."""
    return MotionLimits(np.zeros(3), np.eye(3), np.full(3, 10.0), np.zeros((0, 6)), np.eye(3))


def hull_of(points: Array) -> BodyHull:
    hull = hull_around(points)
    assert hull is not None
    return hull


BOX = hull_of(CORNERS)


def hull_of_surface(sigma_m: float, marks: Landmarks | None = None, unseen: float | None = None) -> BodyHull:
    """Of the box as a surface, of which a share that faces +x was not seen."""
    coverage = None
    if unseen is not None:
        seen = {"seen": 1.0 - unseen, "seen_unlit": 0.0, "unseen": unseen, "of": "hull", "words": ""}
        coverage = Coverage.model_validate(seen | {"unseen_direction_G": (1.0, 0.0, 0.0)})
    n = len(CORNERS)
    surface = SurfaceModel(trimesh.creation.box(BOX_M), np.full(n, sigma_m), np.full(n, 5, dtype=np.int64))
    hull = body_hull(surface, marks, coverage)
    assert hull is not None
    return hull


def test_a_box_has_six_sides_and_points_fill_it_evenly() -> None:
    np.testing.assert_allclose(np.sort(BOX.offsets), np.repeat(BOX_M / 2, 2), atol=1e-9)
    np.testing.assert_allclose(BOX.middle, 0.0, atol=1e-12)
    assert BOX.radius_m == pytest.approx(np.linalg.norm(BOX_M) / 2)
    points = BOX.points(160)
    assert len(points) == 160 and np.all(np.abs(points) <= BOX_M / 2 + 1e-9)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(points.std(axis=0), BOX_M / np.sqrt(12), rtol=0.03)
    np.testing.assert_array_equal(points, BOX.points(160))
    for flat in (CORNERS[:3], CORNERS * [1.0, 1.0, 0.0], np.zeros((0, 3))):
        assert hull_around(flat) is None


def test_the_hull_grows_by_three_sigmas_and_by_landmarks_that_are_seen_three_times() -> None:
    sides = np.sort(hull_of_surface(0.002).offsets)
    np.testing.assert_allclose(sides, np.repeat(BOX_M / 2, 2) + 0.006, atol=1e-9)
    points = np.array([[0.2, 0.0, 0.0], [0.0, 0.5, 0.0]])
    marks = Landmarks(points, np.full(2, 1e-3), np.array([3, 2]))
    assert hull_of_surface(0.0, marks).vertices.max(axis=0) == pytest.approx([0.2, 0.2, 0.3])


@pytest.mark.parametrize(("unseen", "share"), [(0.1, 0.1273), (0.2, 0.2546), (0.4, 0.5093), (0.6, 0.6667)])
def test_a_part_that_was_not_seen_extends_the_hull_towards_it(unseen: float, share: float) -> None:
    hull = hull_of_surface(0.0, unseen=unseen)
    low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    np.testing.assert_allclose(low, -BOX_M / 2, atol=1e-9)
    np.testing.assert_allclose(high, BOX_M / 2 + [share * BOX_M[0], 0.0, 0.0], atol=1e-4)
    # one that faces all around extends it on all sides
    around = hull_around(CORNERS, 0.0, 0.25, None)
    assert around is not None
    np.testing.assert_allclose(np.ptp(around.vertices, axis=0), (1.0 + 0.25 * 1.08 / np.pi / 0.27) * BOX_M)


def test_the_centre_of_mass_lies_between_the_sides_that_the_axis_of_rotation_pierces() -> None:
    for axis in range(3):
        found = com_extremes(BOX, spin_limits(axis, (0.02, -0.03, 0.05)), np.eye(3))
        assert found is not None
        expected = np.tile([0.02, -0.03, 0.05], (2, 1))
        expected[:, axis] = [-BOX_M[axis] / 2, BOX_M[axis] / 2]
        np.testing.assert_allclose(found[axis], expected, atol=1e-9)
    # of a target at rest it is anywhere inside; an axis that misses the body has none
    found = com_extremes(BOX, no_limits(), np.eye(3))
    assert found is not None
    np.testing.assert_allclose(found[:, 1].diagonal(), BOX_M / 2, atol=1e-9)
    assert com_extremes(BOX, spin_limits(2, (0.5, 0.0, 0.0)), np.eye(3)) is None
    # an oblique axis ends at the flat sides of a cylinder, as long as |y| stays below the radius
    hull = hull_of(trimesh.creation.cylinder(0.2, 0.5, sections=360).vertices)
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    axes = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    end = farthest_com(hull, replace(spin_limits(2), com_axes=axes), axes[:, 2])
    assert end is not None
    np.testing.assert_allclose(end, axes[:, 2] * 0.5 * 0.5 / c, atol=1e-6)


def ratios_of(limits: MotionLimits, density: float, *centers: tuple[float, float, float]) -> RatioIntervals:
    found = ratio_intervals(BOX.points(160), np.array(centers or [(0.0, 0.0, 0.0)]), limits, density)
    assert found is not None
    return found


def log_ratios(moments: np.ndarray) -> np.ndarray:
    a, b, c = np.sort(moments)[::-1]
    return np.log([a / b, b / c])


def test_a_nearly_uniform_density_leaves_the_ratios_of_the_box() -> None:
    expected = log_ratios((BOX_M**2).sum() - BOX_M**2)
    found = ratios_of(no_limits(), 1.01)
    np.testing.assert_allclose(found.low, expected, atol=0.05)
    np.testing.assert_allclose(found.high, expected, atol=0.05)
    assert np.all(found.low < found.high)


@pytest.mark.parametrize("limits", [no_limits(), spin_limits(0)])
def test_dense_parts_allow_a_sphere_a_disc_and_a_needle(limits: MotionLimits) -> None:
    found = ratios_of(limits, 8.0)
    # a sphere of an eighth of the volume has a radius of 0.129 m and lies inside
    np.testing.assert_array_equal(found.low, 0.0)
    # a disc of the smaller width fills an eighth of the volume 0.072 m thick; a thin one would have ln 2
    disc = np.log((0.2**2 / 2) / (0.2**2 / 4 + 0.0716**2 / 12))
    assert disc - 0.02 < found.high[0] <= np.log(2.0)
    # two ends of 0.3 x 0.4 m and an eighth of the height apart would have ln 8; a cylinder along z, ln 13
    assert 2.5 < found.high[1] < 3.0


def test_more_density_or_another_centre_widens_the_ratios_and_random_bodies_lie_inside() -> None:
    wide, middle, narrow = (ratios_of(spin_limits(2), density) for density in (8.0, 4.0, 2.0))
    assert np.all(narrow.high < wide.high) and np.all(narrow.low >= wide.low)
    both = ratios_of(spin_limits(2), 4.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.15))
    assert np.all(both.low <= middle.low) and np.all(both.high >= middle.high)
    # nothing fits a centre of mass at the end of the hull
    assert ratio_intervals(BOX.points(160), np.array([[0.0, 0.0, 0.299]]), no_limits(), 4.0) is None
    # boxes inside the hull, at most eight times as dense, turned about the spin axis
    rng = np.random.default_rng(3)
    for _ in range(200):
        inner = BOX_M * rng.uniform(0.4, 1.0, 3)
        R = exp_so3(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        corners = trimesh.creation.box(inner).vertices @ R.T
        if np.all(np.abs(corners) <= BOX_M / 2) and np.prod(inner / BOX_M) >= 1.0 / 8.0:
            k = log_ratios((inner**2).sum() - inner**2)
            assert np.all(k >= wide.low - 0.03) and np.all(k <= wide.high + 0.03)


def test_nearly_equal_moments_count_as_possibly_equal() -> None:
    """The search ends a little above 0; a body of revolution must not be excluded by that."""
    rows = np.zeros((2, 6))
    # |Jxx - Jyy| at most 1 % of the trace
    rows[:, :2] = [[1.0, -1.0], [-1.0, 1.0]]
    rows[:, :3] -= 0.01
    narrow = replace(no_limits(), inertia_rows=np.concatenate([rows, spin_limits(2).inertia_rows]))
    np.testing.assert_array_equal(ratios_of(narrow, 8.0).low, 0.0)
