"""The search near a row finds what the comparison of all key points with all finds."""

import numpy as np

from polhode.frontend.features.epipolar_search import MAX_OCTAVES, MAX_TURN_RAD, mutual_nearest
from polhode.frontend.features.keypoints import KeyPoints, no_key_points
from polhode.geometry.lie import Array, Ints


def points(seed: int, n: int) -> KeyPoints:
    """On a patch of 40 by 30 px, so that each has several others near its row."""
    rng = np.random.default_rng(seed)
    descriptors = rng.normal(size=(n, 16)).astype(np.float32) + np.float32(1.0)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    uv = rng.uniform([0.0, 0.0], [40.0, 30.0], (n, 2))
    return KeyPoints(uv, rng.uniform(1.0, 4.0, n), rng.uniform(0.0, 2.0 * np.pi, n), descriptors)


def by_comparing_all(
    left: KeyPoints, right: KeyPoints, gate_px: Array, shifts_px: tuple[float, float], ratio: float
) -> tuple[Ints, Ints]:
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
    return kept, best[kept]


def test_it_finds_what_the_comparison_of_all_finds() -> None:
    left, right = points(1, 300), points(2, 280)
    gate_px = np.maximum(1.0, 0.4 * left.scale_px)
    found = mutual_nearest(left, right, gate_px, (-10.0, 25.0), 0.9)
    expected = by_comparing_all(left, right, gate_px, (-10.0, 25.0), 0.9)
    assert 20 < len(found[0]) < len(left)
    np.testing.assert_array_equal(found, expected)


def test_without_key_points_nothing_matches() -> None:
    some = points(3, 20)
    for left, right in ((some, no_key_points()), (no_key_points(), some)):
        kept, matched = mutual_nearest(left, right, np.ones(len(left)), (-9.0, 9.0), 0.9)
        assert len(kept) == len(matched) == 0
