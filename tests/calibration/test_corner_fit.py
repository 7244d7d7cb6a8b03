"""A fitted corner is where it was drawn, whatever its edges' directions, bends and blur."""

import cv2
import numpy as np
import pytest

from polhode.calibration.corner_fit import fit_corners
from polhode.files.images import Grey
from polhode.geometry.lie import Array

SIDE, FINE = 41, 8


def drawn(corner: Array, angles: tuple[float, float], bend: float, noise: float = 0.0, seed: int = 0) -> Grey:
    """Four squares that meet at a corner (2,), their edges bent by ``bend`` [1/px]; pixels are means."""
    steps = (np.arange(SIDE * FINE) + 0.5) / FINE - 0.5
    x, y = np.meshgrid(steps - corner[0], steps - corner[1])
    fine = np.full(x.shape, 85.0)
    for angle in angles:
        along = -x * np.sin(angle) + y * np.cos(angle)
        distance = x * np.cos(angle) + y * np.sin(angle) + 0.5 * bend * along**2
        fine *= np.clip(2.0 * FINE * distance, -1.0, 1.0)
    # the optics blur before the pixels add up the light
    fine = cv2.GaussianBlur(115.0 + fine, (0, 0), 0.7 * FINE)
    grey = fine.reshape(SIDE, FINE, SIDE, FINE).mean(axis=(1, 3))
    grey = grey + noise * np.random.default_rng(seed).standard_normal(grey.shape)
    return np.asarray(np.clip(np.round(grey), 0, 255), dtype=np.uint8)


@pytest.mark.parametrize(
    ("angles", "bend"), [((0.0, 1.57), 0.0), ((0.3, 1.5), 0.0), ((-0.7, 0.6), 0.0), ((0.2, 1.8), 0.02)]
)
def test_corners_are_found_to_a_hundredth_of_a_pixel(angles: tuple[float, float], bend: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(4):
        corner = np.array([20.0, 20.0]) + rng.uniform(-0.5, 0.5, 2)
        start = corner + rng.uniform(-0.3, 0.3, 2)
        found = fit_corners(drawn(corner, angles, bend), start[None], np.array([7.0]))[0]
        assert np.linalg.norm(found - corner) < 0.01


def test_noise_moves_a_corner_by_hundredths_of_a_pixel() -> None:
    corner, noise = np.array([20.3, 19.8]), 4.0
    start = corner[None] + 0.2
    off = [
        fit_corners(drawn(corner, (0.2, 1.7), 0.0, noise, seed), start, np.array([7.0]))[0] - corner
        for seed in range(24)
    ]
    assert 0.015 < np.sqrt(np.mean(np.square(off))) < 0.03


def test_what_is_no_corner_of_four_squares_stays_where_it_was() -> None:
    flat, edge = np.full((SIDE, SIDE), 90, np.uint8), np.full((SIDE, SIDE), 30, np.uint8)
    edge[:, 20:] = 200
    start = np.array([[20.2, 20.4], [1.0, 1.0], [np.nan, np.nan]])
    for image in (flat, edge):
        np.testing.assert_array_equal(fit_corners(image, start, np.full(3, 6.0)), start)
