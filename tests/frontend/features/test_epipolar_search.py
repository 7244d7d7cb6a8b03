"""The search near a row, and matches that ignore the epipolar constraint."""

import numpy as np
import pytest

from polhode.frontend.features.epipolar_search import MAX_OCTAVES, MAX_TURN_RAD, mutual_nearest, row_offsets
from polhode.frontend.features.keypoints import KeyPoints, no_key_points
from polhode.geometry.lie import Array
from tests.frontend.feature_world import unit


def points(seed: int, n: int) -> KeyPoints:
    """On a patch of 40 by 30 px, so that each has several others near its row."""
    rng = np.random.default_rng(seed)
    descriptors = unit(rng.normal(size=(n, 16)) + 1.0).astype(np.float32)
    uv = rng.uniform([0.0, 0.0], [40.0, 30.0], (n, 2))
    return KeyPoints(uv, rng.uniform(1.0, 4.0, n), rng.uniform(0.0, 2.0 * np.pi, n), descriptors)


def test_it_finds_what_the_comparison_of_all_finds() -> None:
    left, right = points(1, 300), points(2, 280)
    gate_px, shifts_px, ratio = np.maximum(1.0, 0.4 * left.scale_px), (-10.0, 25.0), 0.9
    shift = left.uv_px[:, None, 0] - right.uv_px[None, :, 0]
    turn = (left.angle_rad[:, None] - right.angle_rad[None, :] + np.pi) % (2.0 * np.pi) - np.pi
    allowed = np.abs(left.uv_px[:, None, 1] - right.uv_px[None, :, 1]) < gate_px[:, None]
    allowed &= (shift > shifts_px[0]) & (shift < shifts_px[1]) & (np.abs(turn) < MAX_TURN_RAD)
    allowed &= np.abs(np.log2(left.scale_px[:, None] / right.scale_px[None, :])) < MAX_OCTAVES
    alike = np.where(allowed, left.descriptors @ right.descriptors.T, -1.0)
    best, rows = alike.argmax(axis=1), np.arange(len(left))
    mutual = (alike.argmax(axis=0)[best] == rows) & (alike.max(axis=1) > 0.0)
    two = np.sqrt(2.0 - 2.0 * np.sort(alike, axis=1)[:, -2:])
    kept = np.flatnonzero(mutual & (two[:, 1] < ratio * two[:, 0]))
    found = mutual_nearest(left, right, gate_px, shifts_px, ratio)
    assert 20 < len(found[0]) < len(left)
    np.testing.assert_array_equal(found, (kept, best[kept]))


def test_without_key_points_nothing_matches() -> None:
    some = points(3, 20)
    for left, right in ((some, no_key_points()), (no_key_points(), some)):
        kept, matched = mutual_nearest(left, right, np.ones(len(left)), (-9.0, 9.0), 0.9)
        assert len(kept) == len(matched) == 0
        assert len(row_offsets(left, right, 640).uv_px) == 0


@pytest.mark.parametrize("disparity", [60.0, -60.0])
@pytest.mark.parametrize("offset", [0.0, 1.6, -3.0, 40.0])
def test_rows_that_differ_and_images_that_are_exchanged_are_measured(disparity: float, offset: float) -> None:
    """Not rows that are farther apart than a knock puts them."""
    rng = np.random.default_rng(1)
    uv = rng.uniform([200, 100], [440, 380], (120, 2))
    looks = unit(rng.normal(size=(120, 32))).astype(np.float32)

    def key_points(uv: Array) -> KeyPoints:
        return KeyPoints(uv, np.full(120, 2.0), np.zeros(120), looks)

    found = row_offsets(key_points(uv), key_points(uv - [disparity, offset]), 640)
    if offset == 40.0:
        assert len(found.uv_px) < 10
    else:
        assert len(found.uv_px) == len(uv)
        np.testing.assert_allclose(found.offset_px, offset, atol=1e-9)
        np.testing.assert_allclose(found.disparity_px, disparity, atol=1e-9)
