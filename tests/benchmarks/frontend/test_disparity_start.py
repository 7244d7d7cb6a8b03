"""The trial of a learned start of disparity: its aggregation, its truth, and what it finds."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmarks.frontend.disparity_start import (
    COST_SCALES,
    Seen,
    StartHead,
    StartMethod,
    TrainingPair,
    best_disparities,
    cost_volume,
    loss_of,
    patch_vectors,
    seen_by_right,
    sum_of_paths,
    trained_head,
)
from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.sgbm import cut_crop
from polhode.frontend.features.surface_network import surface_network
from polhode.frontend.networks.surface import CHANNELS, JUDGED, SurfaceNet

SHIFT_PX = 6


@pytest.fixture
def network() -> SurfaceNet:
    return surface_network().eval()


def shifted_pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]:
    """A textured square before a dark sky, displaced by ``SHIFT_PX`` in the right image; its mask."""
    rng = np.random.default_rng(3)
    left = np.full((96, 128), 2, np.uint8)
    left[20:76, 40:100] = rng.integers(40, 200, (56, 60))
    return left, np.roll(left, -SHIFT_PX, axis=1), left > 10


def test_paths_are_those_of_their_definition() -> None:
    """Eight recursions of Hirschmueller (2008), one pixel after the other."""
    cost = np.random.default_rng(0).integers(0, 60, (5, 6, 7)).astype(np.int16)
    small, large = 5, 20
    h, w, n = cost.shape
    total = np.zeros(cost.shape, int)
    for dv, du in ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)):
        path = np.zeros(cost.shape, int)
        for v in range(h) if dv >= 0 else range(h - 1, -1, -1):
            for u in range(w) if du >= 0 else range(w - 1, -1, -1):
                path[v, u] = cost[v, u]
                if 0 <= v - dv < h and 0 <= u - du < w:
                    before = path[v - dv, u - du]
                    steps = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :])
                    penalty = np.where(steps == 0, 0, np.where(steps == 1, small, large))
                    path[v, u] += (before + penalty).min(axis=1) - before.min()
        total += path
    np.testing.assert_array_equal(sum_of_paths(cost, small, large), total)


def test_the_volume_finds_a_shift_between_pixels() -> None:
    rng = np.random.default_rng(1)
    n, true = 8, 3
    right = rng.normal(size=(4, 12, 30 + n)).astype(np.float32)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    left = right[:, :, n - true : n - true + 30]
    cost = cost_volume(np.ascontiguousarray(left), np.ascontiguousarray(right[:, :, ::-1]), n)
    np.testing.assert_allclose(cost[..., true], 0.0, atol=1e-5)
    disparity, distinct, seen_right = best_disparities(cost)
    # Neighbours are unrelated here: the parabola moves a place by less than half a pixel.
    assert (np.round(disparity) == true).all()
    assert (distinct > 0).all()
    assert (seen_right[:, n - true : n - true + 30] == true).all()
    d = np.arange(n, dtype=np.float32)
    parabola = np.broadcast_to((d - 2.75) ** 2, (2, 3, n)).astype(np.float32)
    np.testing.assert_allclose(best_disparities(np.ascontiguousarray(parabola))[0], 2.75, atol=1e-5)


def test_what_a_nearer_surface_hides_is_not_learned() -> None:
    disparity = np.full((1, 40), np.nan, np.float32)
    disparity[0, 10:20], disparity[0, 20:30] = 2.0, 6.0
    # The far surface ends up in columns 8 to 17, the near one in 14 to 23.
    seen = seen_by_right(disparity)[0]
    assert seen[10:15].all() and seen[20:30].all()
    assert not seen[16:20].any()
    assert not seen[:10].any() and not seen[30:].any()


def test_the_loss_is_that_of_the_truth() -> None:
    head = StartHead()
    judged = torch.zeros(1, JUDGED, 8, 20)
    seen = Seen(judged, torch.zeros(1, CHANNELS, 8, 20))
    disparity = np.full((8, 20), np.nan, np.float32)
    disparity[2:5, 8:12] = 1.5
    # All candidates from -3 to 6 look alike except those beyond the image, of which there are none here.
    assert loss_of(head, seen, seen, disparity, 0).item() == pytest.approx(np.log(10.0), rel=1e-5)


@pytest.mark.parametrize("paths", [False, True])
def test_patches_find_a_shifted_square(network: SurfaceNet, paths: bool) -> None:
    left, right, mask = shifted_pair()
    crop = cut_crop(left, right, mask, (SHIFT_PX - 2.0, SHIFT_PX + 2.0), Depth())
    method = StartMethod(network, patch_vectors, COST_SCALES["image"] if paths else None)
    disparity = method(crop)[0] + crop.shift_px
    found = disparity[mask[crop.inner]]
    assert np.isfinite(found).mean() > 0.95
    assert np.nanmax(np.abs(found - SHIFT_PX)) < 0.2
    assert len(method.after_s) == len(method.right_look_s) == 1


def test_a_few_steps_teach_the_head_where_the_square_is(network: SurfaceNet) -> None:
    left, right, mask = shifted_pair()
    truth = np.where(mask, np.float32(SHIFT_PX), np.float32(np.nan))
    pair = TrainingPair(left, mask, right, np.roll(mask, -SHIFT_PX, axis=1), truth)
    head = trained_head(network, [pair], 30, whole=False)
    crop = cut_crop(left, right, mask, (SHIFT_PX - 2.0, SHIFT_PX + 2.0), Depth())
    disparity = StartMethod(network, lambda seen: head(seen.judged), COST_SCALES["head"])(crop)[0]
    found = (disparity + crop.shift_px)[mask[crop.inner]]
    assert np.isfinite(found).mean() > 0.95
    assert np.nanmedian(np.abs(found - SHIFT_PX)) < 0.1
