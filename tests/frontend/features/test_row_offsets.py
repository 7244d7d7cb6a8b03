"""Matches that ignore the epipolar constraint: rows that differ, disparities of either sign."""

import numpy as np
import pytest

from polhode.frontend.features.keypoints import KeyPoints, no_key_points
from polhode.frontend.features.row_offsets import row_offsets
from polhode.geometry.lie import Array

WIDTH_PX = 640


def points(uv_px: Array, seed: int = 0) -> KeyPoints:
    """Each with a descriptor of its own, the same in both images."""
    rng = np.random.default_rng(seed)
    descriptors = rng.normal(size=(len(uv_px), 32))
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    n = len(uv_px)
    return KeyPoints(uv_px, np.full(n, 2.0), np.zeros(n), descriptors.astype(np.float32))


@pytest.mark.parametrize("disparity", [60.0, -60.0])
@pytest.mark.parametrize("offset", [0.0, 1.6, -3.0])
def test_rows_that_differ_and_images_that_are_exchanged_are_measured(disparity: float, offset: float) -> None:
    left = np.random.default_rng(1).uniform([200, 100], [440, 380], (120, 2))
    found = row_offsets(points(left), points(left - [disparity, offset]), WIDTH_PX)
    assert len(found.uv_px) == len(left)
    np.testing.assert_allclose(found.offset_px, offset, atol=1e-9)
    np.testing.assert_allclose(found.disparity_px, disparity, atol=1e-9)


def test_rows_farther_apart_than_a_knock_puts_them_are_not_compared() -> None:
    left = np.random.default_rng(1).uniform([200, 100], [440, 380], (120, 2))
    found = row_offsets(points(left), points(left - [60.0, 40.0]), WIDTH_PX)
    assert len(found.uv_px) < 10


def test_an_empty_image_matches_nothing() -> None:
    some = points(np.array([[300.0, 200.0]]))
    assert len(row_offsets(some, no_key_points(), WIDTH_PX).uv_px) == 0
    assert len(row_offsets(no_key_points(), some, WIDTH_PX).uv_px) == 0
