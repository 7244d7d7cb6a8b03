"""The centre of mass of a pure spin lies where its axis is inside the hull."""

import numpy as np
import pytest
import trimesh

from polhode.pipeline.intervals.body_hull import BodyHull, hull_around
from polhode.pipeline.intervals.centre_of_mass import com_extremes, farthest_com
from tests.pipeline.intervals.limits import no_limits, spin_limits

BOX_M = np.array([0.3, 0.4, 0.6])


def _box() -> BodyHull:
    hull = hull_around(trimesh.creation.box(BOX_M).vertices)
    assert hull is not None
    return hull


BOX = _box()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_of_a_box_between_the_sides_that_the_axis_pierces(axis: int) -> None:
    limits = spin_limits(axis, (0.02, -0.03, 0.05))
    found = com_extremes(BOX, limits, np.eye(3))
    assert found is not None
    expected = np.tile([0.02, -0.03, 0.05], (2, 1))
    expected[:, axis] = [-BOX_M[axis] / 2, BOX_M[axis] / 2]
    np.testing.assert_allclose(found[axis], expected, atol=1e-9)


def test_of_an_oblique_axis_through_a_cylinder() -> None:
    radius_m, height_m, angle = 0.2, 0.5, np.deg2rad(30.0)
    hull = hull_around(trimesh.creation.cylinder(radius_m, height_m, sections=360).vertices)
    assert hull is not None
    along = np.array([0.0, np.sin(angle), np.cos(angle)])
    across = np.array([0.0, np.cos(angle), -np.sin(angle)])
    limits = spin_limits(2)
    limits = type(limits)(
        limits.center_G,
        np.stack([np.array([1.0, 0.0, 0.0]), across, along], axis=1),
        limits.com_margin_m,
        limits.inertia_rows,
        limits.R_GP,
    )
    end = farthest_com(hull, limits, along)
    assert end is not None
    # through the flat ends as long as |y| stays below the radius
    np.testing.assert_allclose(end, along * 0.5 * height_m / np.cos(angle), atol=1e-6)


def test_of_a_target_at_rest_anywhere_inside() -> None:
    found = com_extremes(BOX, no_limits(), np.eye(3))
    assert found is not None
    np.testing.assert_allclose(found[:, 1].diagonal(), BOX_M / 2, atol=1e-9)


def test_an_axis_that_misses_the_body_has_none() -> None:
    assert farthest_com(BOX, spin_limits(2, (0.5, 0.0, 0.0)), np.array([0.0, 0.0, 1.0])) is None
    assert com_extremes(BOX, spin_limits(2, (0.5, 0.0, 0.0)), np.eye(3)) is None
