"""k1 and k2 of every mass inside a hull, against bodies whose moments are known."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from polhode.lie import exp_so3
from polhode.pipeline.intervals.body_hull import BodyHull, hull_around
from polhode.pipeline.intervals.inertia_ratios import RatioIntervals, ratio_intervals
from polhode.pipeline.intervals.motion_limits import MotionLimits
from tests.pipeline.intervals.limits import no_limits, spin_limits

BOX_M = np.array([0.3, 0.4, 0.6])
CENTER = np.zeros((1, 3))


def box_hull() -> BodyHull:
    hull = hull_around(trimesh.creation.box(BOX_M).vertices)
    assert hull is not None
    return hull


def found_of(limits: MotionLimits, ratio: float, centers: np.ndarray = CENTER) -> RatioIntervals:
    found = ratio_intervals(box_hull().points(160), centers, limits, ratio)
    assert found is not None
    return found


def log_ratios(moments: np.ndarray) -> np.ndarray:
    a, b, c = np.sort(moments)[::-1]
    return np.log([a / b, b / c])


def test_a_nearly_uniform_density_leaves_the_ratios_of_the_box() -> None:
    squares = BOX_M**2
    expected = log_ratios(squares.sum() - squares)
    found = found_of(no_limits(), 1.01)
    np.testing.assert_allclose(found.low, expected, atol=0.05)
    np.testing.assert_allclose(found.high, expected, atol=0.05)
    assert np.all(found.low < found.high)


@pytest.mark.parametrize("limits", [no_limits(), spin_limits(2), spin_limits(0)])
def test_dense_parts_allow_a_sphere_a_disc_and_a_needle(limits: MotionLimits) -> None:
    found = found_of(limits, 8.0)
    # a sphere of an eighth of the volume has a radius of 0.129 m and lies inside
    np.testing.assert_array_equal(found.low, 0.0)
    # a disc of the smaller width fills an eighth of the volume 0.072 m thick; a thin one would have ln 2
    disc = np.log((0.2**2 / 2) / (0.2**2 / 4 + 0.0716**2 / 12))
    assert disc - 0.02 < found.high[0] <= np.log(2.0)
    # two ends of 0.3 x 0.4 m and an eighth of the height apart would have ln 8; a cylinder along z, ln 13
    assert 2.5 < found.high[1] < 3.0


def test_a_larger_range_of_densities_gives_a_wider_interval() -> None:
    wide, narrow = found_of(spin_limits(2), 8.0), found_of(spin_limits(2), 2.0)
    assert np.all(narrow.high < wide.high) and np.all(narrow.low >= wide.low)


def test_the_interval_holds_for_every_centre_of_mass() -> None:
    centers = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.15]])
    both, one = found_of(spin_limits(2), 4.0, centers), found_of(spin_limits(2), 4.0)
    assert np.all(both.low <= one.low) and np.all(both.high >= one.high)


def test_nothing_fits_a_centre_of_mass_at_the_end_of_the_hull() -> None:
    points = box_hull().points(160)
    assert ratio_intervals(points, np.array([[0.0, 0.0, 0.299]]), no_limits(), 4.0) is None


def test_random_possible_bodies_lie_inside() -> None:
    """Boxes inside the hull, at most eight times as dense, shifted and turned about the spin axis."""
    rng = np.random.default_rng(3)
    found = found_of(spin_limits(2), 8.0)
    for _ in range(200):
        inner = BOX_M * rng.uniform(0.4, 1.0, 3)
        R = exp_so3(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        corners = trimesh.creation.box(inner).vertices @ R.T
        if np.any(np.abs(corners) > BOX_M / 2) or np.prod(inner / BOX_M) < 1.0 / 8.0:
            continue
        k = log_ratios((inner**2).sum() - inner**2)
        assert np.all(k >= found.low - 0.03) and np.all(k <= found.high + 0.03)


def test_nearly_equal_moments_count_as_possibly_equal() -> None:
    """The search ends a little above 0; a body of revolution must not be excluded by that."""
    rows = np.zeros((2, 6))
    # |Jxx - Jyy| at most 1 % of the trace
    rows[:, :2] = [[1.0, -1.0], [-1.0, 1.0]]
    rows[:, :3] -= 0.01
    narrow = replace(no_limits(), inertia_rows=np.concatenate([rows, spin_limits(2).inertia_rows]))
    found = found_of(narrow, 8.0)
    assert found.low[0] == 0.0 and found.low[1] == 0.0
