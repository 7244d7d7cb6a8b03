"""Dense depth of planes and boxes painted with noise: the classical method, and the range of disparities."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.depth import compute_depth, find_disparity_range, range_of_features
from polhode.geometry.lie import Array, Bools
from polhode.records.surface import DepthMap
from tests.frontend.disparity.painted_planes import RIG, pair_of, rectangle, slanted

CONFIG = Depth(method="sgbm")
MASK = rectangle(slice(60, 180), slice(110, 230))


def errors_px(depth: DepthMap, true: Array, infinity_px: float = 0.0) -> Array:
    """Errors (n,) of the disparities where there is depth."""
    known = np.isfinite(depth.depth_m)
    return np.asarray(RIG.focal_px * RIG.baseline_m / depth.depth_m[known] + infinity_px - true[known])


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.05, 0.03), (0.1, 0.05), (-0.12, 0.1)])
def test_a_textured_plane_is_found_to_a_few_hundredths_of_a_pixel(slopes: tuple[float, float]) -> None:
    true = slanted(50.3, *slopes)
    depth = compute_depth(*pair_of(true, MASK), MASK, RIG, CONFIG)
    known, error = np.isfinite(depth.depth_m), errors_px(depth, true)
    assert known[MASK].mean() > 0.85
    assert np.median(np.abs(error)) < 0.05 and np.percentile(np.abs(error), 99) < 0.4
    assert abs(np.median(error)) < 0.02
    # nothing is known beside the target and along its rim
    rim = MASK & ~(cv2.erode(MASK.astype(np.uint8), np.ones((3, 3))) > 0)
    assert not known[~MASK | rim].any()
    np.testing.assert_array_equal(known, np.isfinite(depth.sigma_m))
    error_m = np.abs(depth.depth_m[known] - RIG.focal_px * RIG.baseline_m / true[known])
    assert 0.5 < np.mean(error_m < depth.sigma_m[known]) < 0.99 or slopes != (0.05, 0.03)
    assert np.mean(error_m < 3 * depth.sigma_m[known]) > 0.97


def test_no_depth_without_texture_or_light() -> None:
    left, right = pair_of(slanted(50.0, 0.0, 0.0), MASK)
    left[100:140, 150:190] = 4
    for image in (left, right):
        image[100:140, 60:210] = np.random.default_rng(1).integers(2, 7, (40, 150))
    depth = compute_depth(left, right, MASK, RIG, CONFIG)
    assert not np.isfinite(depth.depth_m[104:136, 115:205]).any()
    assert np.isfinite(depth.depth_m[MASK]).mean() > 0.4
    black = np.zeros((240, 320), dtype=np.uint8)
    for inside in (MASK, np.zeros_like(MASK)):
        assert not np.isfinite(compute_depth(black, black, inside, RIG, CONFIG).depth_m).any()


@pytest.mark.parametrize(
    ("base_px", "infinity_px"), [(12.0, 0.0), (90.0, 0.0), (-60.0, -554.0), (-8.0, -554.0), (50.0, -554.0)]
)
def test_the_range_is_found_also_where_converging_axes_cross(base_px: float, infinity_px: float) -> None:
    """Infinity may lie 554 px off, out of both images."""
    true = slanted(base_px, 0.05, 0.0)
    left, right = pair_of(true, MASK)
    found = find_disparity_range(left, right, MASK, CONFIG, infinity_px)
    assert found is not None
    assert found[0] <= true[MASK].min() + 1 and found[1] >= true[MASK].max() - 1
    assert found[1] - found[0] < 40
    if infinity_px < 0.0:
        depth = compute_depth(left, right, MASK, replace(RIG, disparity_offset_px=infinity_px), CONFIG)
        assert np.isfinite(depth.depth_m)[MASK].mean() > 0.85
        assert np.abs(errors_px(depth, true, infinity_px)).max() < 2e-3 * (base_px - infinity_px)


@pytest.mark.parametrize(
    ("mask", "base_px", "slope", "infinity_px", "span"),
    [
        (rectangle(slice(60, 240), slice(60, 320)), 50.0, 0.02, 0.0, (45.0, 55.0)),
        (MASK, -6.0, 0.08, -40.0, (-11.0, -1.0)),
        (MASK, -6.0, 0.08, -40.0, None),
    ],
    ids=["at the edge of the image", "negative disparity", "negative disparity, range not known"],
)
def test_special_places_are_no_special_cases(
    mask: Bools, base_px: float, slope: float, infinity_px: float, span: tuple[float, float] | None
) -> None:
    true = slanted(base_px, slope, 0.0)
    rig = replace(RIG, disparity_offset_px=infinity_px)
    depth = compute_depth(*pair_of(true, mask), mask, rig, CONFIG, span)
    assert np.isfinite(depth.depth_m)[mask].mean() > 0.8
    assert np.median(np.abs(errors_px(depth, true, infinity_px))) < 0.06


def test_a_few_wrong_features_do_not_widen_the_range() -> None:
    disparity = np.linspace(50.0, 70.0, 400)
    low, high = range_of_features(disparity) or (0.0, 0.0)
    assert low < 50.0 and high > 70.0 and high - low < 40.0
    wrong = np.concatenate([disparity, [5.0, 160.0]])
    assert np.abs(np.subtract(range_of_features(wrong) or (0.0, 0.0), (low, high))).max() < 1.0
    assert range_of_features(disparity[:10]) is None
