"""Masks by ranges: a disk before a wall, before nothing, and in a room that is no plane."""

import numpy as np
import pytest

from polhode.frontend.background.far_plane import FarPlane
from polhode.frontend.background.range_layer import near_range_layer, range_plane
from polhode.frontend.rectification import MeasuredDisparity
from polhode.geometry.lie import Array, Bools
from tests.frontend.background.synthetic_pairs import HEIGHT, WIDTH, U, V, overlap

OFFSET_PX, SIGMA_PX = 4.0, 0.25
WALL = FarPlane(-0.01, 0.015, 14.0)
BEHIND = WALL.at(WIDTH, HEIGHT).astype(np.float64)
DISK = np.hypot(U - 170.0, V - 115.0) < 50.0


def ranges_of(background: Array, target: Bools = DISK) -> MeasuredDisparity:
    """The target before a background (H, W) [px], with noise, and with dropouts along the edge."""
    rng = np.random.default_rng(2)
    d = np.where(target, 40.0 + 0.05 * (U - 170.0), background) + rng.normal(0.0, SIGMA_PX, U.shape)
    d[(np.abs(np.hypot(U - 170.0, V - 115.0) - 50.0) < 1.0) & (rng.random(d.shape) < 0.5)] = np.nan
    # a twentieth of all pixels returns nothing
    d[rng.random(d.shape) < 0.05] = np.nan
    return MeasuredDisparity(d.astype(np.float32), np.full(d.shape, SIGMA_PX, dtype=np.float32))


def test_a_wall_is_found_and_what_stands_before_it() -> None:
    plane = range_plane(ranges_of(BEHIND), OFFSET_PX)
    assert plane is not None
    np.testing.assert_allclose(plane.corners(WIDTH, HEIGHT), WALL.corners(WIDTH, HEIGHT), atol=0.1)
    layer = near_range_layer(ranges_of(BEHIND), plane)
    assert overlap(layer.left, DISK) > 0.98 and not layer.right.any()
    quality = layer.quality
    assert quality.agreement > 0.99 and quality.contradicted < 0.01 and quality.far_share > 0.99
    assert quality.area == pytest.approx(DISK.mean(), rel=0.03)
    # a window through the target stays open
    open_target = DISK & ~(np.hypot(U - 165.0, V - 110.0) < 15.0)
    assert overlap(near_range_layer(ranges_of(BEHIND, open_target), plane).left, open_target) > 0.97
    # a hole in the wall is doubtful
    holed = BEHIND.copy()
    holed[60:200, 20:110] -= 8.0
    assert near_range_layer(ranges_of(holed), plane).quality.contradicted > 0.5


def test_what_returns_nothing_is_background() -> None:
    measured, sky = ranges_of(np.full(DISK.shape, np.nan)), FarPlane(0.0, 0.0, OFFSET_PX)
    assert range_plane(measured, OFFSET_PX) == sky
    layer = near_range_layer(measured, sky)
    assert overlap(layer.left, DISK) > 0.97 and layer.quality.far_share == 1.0


def test_a_room_whose_border_is_no_plane_has_no_background() -> None:
    box = 14.0 + 20.0 * np.maximum(np.abs(U / WIDTH - 0.5), np.abs(V / HEIGHT - 0.5)) ** 2
    assert range_plane(ranges_of(box + 6.0 * (U > WIDTH / 2) + 9.0 * (V > HEIGHT / 2)), OFFSET_PX) is None
