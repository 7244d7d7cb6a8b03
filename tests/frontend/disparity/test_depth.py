"""Dense depth of planes and boxes painted with noise, rendered by exact warping."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.depth import compute_depth, find_disparity_range, range_of_features
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools

RIG = RectifiedRig(400.0, 159.5, 119.5, 0.1, 320, 240)
CONFIG = Depth(method="sgbm")


def texture(seed: int, height: int = 240, width: int = 1024) -> Array:
    """Noise of several sizes, smooth enough to be sampled between pixels."""
    rng = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), s) * s for s in (1.2, 2.5, 6.0)]
    image = sum(layers[1:], layers[0])
    return np.asarray(110.0 + 35.0 * image / image.std())


def pair_of(
    disparity: Array, mask: Bools, contrast: float = 1.0, noise: float = 1.5, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Left and right image of a surface whose disparity at left pixels (240, 320) is an affine function."""
    painted = 110.0 + contrast * (texture(seed) - 110.0)
    v, u = np.mgrid[:240, :320].astype(np.float32)
    left = cv2.remap(painted.astype(np.float32), u + 300, v, cv2.INTER_CUBIC) * mask
    # u_right = u - d(u, v): solve for u at every right pixel; d is affine in u.
    slope = (disparity[:, -1] - disparity[:, 0])[:, None] / 319.0
    source = ((u + disparity[:, :1]) / (1.0 - slope)).astype(np.float32)
    inside = cv2.remap(mask.astype(np.float32), source, v, cv2.INTER_NEAREST)
    right = cv2.remap(painted.astype(np.float32), source + 300, v, cv2.INTER_CUBIC) * inside
    rng = np.random.default_rng(seed + 100)
    noisy = [np.clip(i + 4 + rng.normal(0, noise, i.shape), 0, 255) for i in (left, right)]
    return noisy[0].round().astype(np.uint8), noisy[1].round().astype(np.uint8)


def slanted(base_px: float, slope_u: float, slope_v: float) -> Array:
    v, u = np.mgrid[:240, :320].astype(np.float64)
    return np.asarray(base_px + slope_u * (u - 160) + slope_v * (v - 120))


@pytest.fixture(scope="module")
def mask() -> Bools:
    inside = np.zeros((240, 320), dtype=bool)
    inside[60:180, 110:230] = True
    return inside


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.1, 0.05), (-0.12, 0.1)])
def test_a_textured_plane_is_found_to_a_few_hundredths_of_a_pixel(
    slopes: tuple[float, float], mask: Bools
) -> None:
    true = slanted(50.3, *slopes)
    left, right = pair_of(true, mask)
    depth = compute_depth(left, right, mask, RIG, CONFIG)
    known = np.isfinite(depth.depth_m)
    error = RIG.focal_px * RIG.baseline_m / depth.depth_m[known] - true[known]
    assert known[mask].mean() > 0.85
    assert np.median(np.abs(error)) < 0.05
    assert np.percentile(np.abs(error), 99) < 0.4
    assert abs(np.median(error)) < 0.02


def test_sigma_tells_the_size_of_the_error_and_nothing_is_known_beside_the_target(mask: Bools) -> None:
    true = slanted(50.3, 0.05, 0.03)
    left, right = pair_of(true, mask)
    depth = compute_depth(left, right, mask, RIG, CONFIG)
    known = np.isfinite(depth.depth_m)
    rim = mask & ~(cv2.erode(mask.astype(np.uint8), np.ones((3, 3))) > 0)
    assert not known[~mask | rim].any()
    np.testing.assert_array_equal(known, np.isfinite(depth.sigma_m))
    error = np.abs(depth.depth_m[known] - RIG.focal_px * RIG.baseline_m / true[known])
    assert 0.5 < np.mean(error < depth.sigma_m[known]) < 0.99
    assert np.mean(error < 3 * depth.sigma_m[known]) > 0.97


def test_no_depth_without_texture_or_light(mask: Bools) -> None:
    true = slanted(50.0, 0.0, 0.0)
    left, right = pair_of(true, mask)
    left[100:140, 150:190] = 4
    for image in (left, right):
        dark = np.random.default_rng(1).integers(2, 7, (40, 150))
        image[100:140, 60:210] = dark
    depth = compute_depth(left, right, mask, RIG, CONFIG)
    assert not np.isfinite(depth.depth_m[104:136, 115:205]).any()
    assert np.isfinite(depth.depth_m[mask]).mean() > 0.4


@pytest.mark.parametrize(
    ("base_px", "infinity_px"), [(12.0, 0.0), (90.0, 0.0), (-60.0, -554.0), (-8.0, -554.0), (50.0, -554.0)]
)
def test_the_range_is_found_also_where_converging_axes_cross(
    base_px: float, infinity_px: float, mask: Bools
) -> None:
    """Infinity may lie 554 px off, out of both images."""
    true = slanted(base_px, 0.05, 0.0)
    left, right = pair_of(true, mask)
    found = find_disparity_range(left, right, mask, CONFIG, infinity_px)
    assert found is not None
    assert found[0] <= true[mask].min() + 1
    assert found[1] >= true[mask].max() - 1
    assert found[1] - found[0] < 40
    if infinity_px < 0.0:
        depth = compute_depth(left, right, mask, replace(RIG, disparity_offset_px=infinity_px), CONFIG)
        known = np.isfinite(depth.depth_m)
        assert known[mask].mean() > 0.85
        expected = RIG.focal_px * RIG.baseline_m / (true - infinity_px)
        np.testing.assert_allclose(depth.depth_m[known], expected[known], rtol=2e-3)


def test_a_target_at_the_images_edge_is_no_special_case() -> None:
    mask = np.zeros((240, 320), dtype=bool)
    mask[60:240, 60:320] = True
    true = slanted(50.0, 0.02, 0.0)
    depth = compute_depth(*pair_of(true, mask), mask, RIG, CONFIG, (45.0, 55.0))
    known = np.isfinite(depth.depth_m)
    error = RIG.focal_px * RIG.baseline_m / depth.depth_m[known] - true[known]
    assert known[mask].mean() > 0.8
    assert np.median(np.abs(error)) < 0.05


def test_an_empty_mask_and_a_black_pair_give_no_depth(mask: Bools) -> None:
    black = np.zeros((240, 320), dtype=np.uint8)
    for inside in (mask, np.zeros_like(mask)):
        depth = compute_depth(black, black, inside, RIG, CONFIG)
        assert not np.isfinite(depth.depth_m).any()


@pytest.mark.parametrize("known", [True, False])
def test_disparities_below_zero_are_found_when_the_principal_points_differ(known: bool, mask: Bools) -> None:
    true = slanted(-6.0, 0.08, 0.0)
    left, right = pair_of(true, mask)
    rig = RectifiedRig(400.0, 159.5, 119.5, 0.1, 320, 240, disparity_offset_px=-40.0)
    depth = compute_depth(left, right, mask, rig, CONFIG, (-11.0, -1.0) if known else None)
    found = np.isfinite(depth.depth_m)
    assert found[mask].mean() > 0.8
    disparity = 400.0 * 0.1 / depth.depth_m - 40.0
    assert np.median(np.abs(disparity - true)[found]) < 0.06


def test_a_few_wrong_features_do_not_widen_the_range() -> None:
    disparity = np.linspace(50.0, 70.0, 400)
    low, high = range_of_features(disparity) or (0.0, 0.0)
    assert low < 50.0 and high > 70.0 and high - low < 40.0
    wrong = np.concatenate([disparity, [5.0, 160.0]])
    assert np.abs(np.subtract(range_of_features(wrong) or (0.0, 0.0), (low, high))).max() < 1.0
    assert range_of_features(disparity[:10]) is None
