"""Disparities of range images: unbiased, with calibrated sigmas, and none where two surfaces meet."""

import cv2
import numpy as np
import pytest

from polhode.frontend.disparity.measured import disparity_at, measured_depth
from polhode.frontend.rectification import (
    MeasuredDisparity,
    RectifiedPair,
    Rectifier,
    make_rectifier,
    measured_disparity,
)
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, make_pose
from polhode.records.range_images import RangeModel
from polhode.records.rig_calibration import StereoCalibration, with_baseline
from polhode.records.surface import DepthMap

SIGMA_PX = 0.25
RIG = RectifiedRig(200.0, 79.5, 59.5, 0.1, 160, 120)
K = np.array([[150.0, 0.0, 79.5], [0.0, 152.0, 59.5], [0.0, 0.0, 1.0]])
DIST = np.array([-0.2, 0.05, 1e-3, -5e-4])
UV = np.random.default_rng(5).uniform([20, 20], [140, 100], (300, 2))


def plane(a: float = 0.0, b: float = 0.0) -> Array:
    """Disparities (120, 160) of a plane."""
    v, u = np.mgrid[:120, :160]
    return np.asarray(20.0 + a * (u - 80) + b * (v - 60), dtype=np.float64)


def noisy(true_px: Array, seed: int) -> MeasuredDisparity:
    noise = np.random.default_rng(seed).normal(0.0, SIGMA_PX, true_px.shape)
    sigma = np.where(np.isfinite(true_px), SIGMA_PX, np.nan)
    return MeasuredDisparity((true_px + noise).astype(np.float32), sigma.astype(np.float32))


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.2, -0.1), (-0.3, 0.25)])
def test_a_point_on_a_plane_has_its_disparity_within_its_sigma(slopes: tuple[float, float]) -> None:
    true = 20.0 + slopes[0] * (UV[:, 0] - 80) + slopes[1] * (UV[:, 1] - 60)
    z = []
    for seed in range(5):
        found, sigma = disparity_at(noisy(plane(*slopes), seed), UV)
        assert np.isfinite(found).all() and np.median(sigma) < 0.2 * SIGMA_PX
        z.append((found - true) / sigma)
    assert abs(np.mean(z)) < 0.1
    assert 0.8 < np.std(z) < 1.1


def test_mixed_and_missing_pixels_do_not_bias_a_point() -> None:
    measured, rng = noisy(plane(0.1, 0.0), 1), np.random.default_rng(2)
    d = measured.disparity_px
    d[rng.random(d.shape) < 0.1] += np.float32(4.0)
    d[rng.random(d.shape) < 0.15] = np.nan
    found, sigma = disparity_at(measured, UV)
    off = found - (20.0 + 0.1 * (UV[:, 0] - 80))
    assert np.isfinite(off).mean() > 0.98
    assert abs(np.nanmean(off)) < 0.02
    assert np.nanstd(off / sigma) < 1.3


def test_a_point_takes_its_own_surface_or_none() -> None:
    jump = plane()
    jump[:, 80:] += 6.0
    u = np.array([80.0 + k for k in (-6, -3, -2, 1, 2, 5)])
    found, _ = disparity_at(noisy(jump, 3), np.column_stack([u, np.full(6, 60.0)]))
    known = np.isfinite(found)
    assert known[[0, -1]].all()
    np.testing.assert_allclose(found[known], np.where(u < 80, 20.0, 26.0)[known], atol=SIGMA_PX)
    ridge = plane()
    ridge[:, 78:83] += 5.0
    found, sigma = disparity_at(noisy(ridge, 4), np.array([[80.0, 60.0]]))
    assert abs(found[0] - 25.0) < 4.0 * sigma[0]
    beside = plane()
    beside[:, 60:] = np.nan
    found, sigma = disparity_at(noisy(beside, 6), np.array([[100.0, 60.0], [3.0, 3.0]]))
    assert np.isnan(found[0]) and np.isnan(sigma[0]) and np.isfinite(found[1])
    assert [len(part) for part in disparity_at(noisy(beside, 6), np.zeros((0, 2)))] == [0, 0]


def depth_of(true: Array, mask: Bools, seed: int) -> DepthMap:
    grey = np.full(mask.shape, 100, dtype=np.uint8)
    pair = RectifiedPair(grey, np.zeros_like(grey), mask, np.zeros_like(mask), noisy(true, seed))
    return measured_depth(pair, RIG, 0.7)


def test_dense_depth_is_that_of_the_ranges_with_less_noise() -> None:
    mask = np.zeros((120, 160), dtype=np.bool_)
    mask[20:100, 30:130] = True
    true = plane(0.05, -0.03)
    depth = depth_of(true, mask, 7)
    known = np.isfinite(depth.depth_m)
    assert known.sum() > 0.9 * mask.sum() and not known[~mask].any()
    off_px = 20.0 / depth.depth_m[known] - true[known]
    assert abs(off_px.mean()) < 0.01
    assert off_px.std() < 0.5 * SIGMA_PX
    sigma_px = depth.sigma_m[known] * 20.0 / depth.depth_m[known] ** 2
    assert 0.5 < np.sqrt(np.mean((off_px / sigma_px) ** 2)) < 1.1


def test_dense_depth_leaves_out_jumps_and_what_is_not_measured() -> None:
    true = plane()
    true[:, 80:] += 8.0
    true[40:50, 20:40] = np.nan
    depth = depth_of(true, np.ones((120, 160), dtype=np.bool_), 8).depth_m
    assert np.isnan(depth[:, 79:81]).all() and np.isnan(depth[41:49, 21:39]).all()
    assert np.isfinite(depth[60:110, 5:75]).all()
    off_px = 20.0 / depth - np.where(np.isfinite(true), true, 0.0)
    assert np.nanmax(np.abs(off_px)) < 6.0 * SIGMA_PX


def rectifier_of(K: Array, dist: Array, baseline_m: float) -> Rectifier:
    X_BC = make_pose(np.eye(3), np.array([0.1, 0.2, 0.0]))
    return make_rectifier(
        with_baseline(StereoCalibration(K, K, dist, dist, X_BC, X_BC, 160, 120), baseline_m)
    )


@pytest.mark.parametrize("along_ray", [False, True])
def test_ranges_of_a_distorted_camera_become_disparities_of_the_rectified_one(along_ray: bool) -> None:
    rectifier, normal = rectifier_of(K, DIST, 0.1), np.array([0.3, -0.2, 1.0])
    v, u = np.mgrid[:120, :160].astype(np.float64)
    uv = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
    flat = cv2.undistortPoints(uv, K, DIST, criteria=stop)[:, 0]
    rays = np.column_stack([flat, np.ones(len(flat))]).reshape(120, 160, 3)
    depth = 1.2 / (rays @ normal)
    ranges = depth * np.linalg.norm(rays, axis=2) if along_ray else depth
    model = RangeModel(1e-4, 0.003, along_ray=along_ray)
    found = measured_disparity(ranges.astype(np.float32), model, rectifier)
    rig, known = rectifier.rig, np.isfinite(found.disparity_px)
    assert rig.disparity_offset_px == 0.0 and known.sum() > 15_000
    v, u = np.mgrid[: rig.height_px, : rig.width_px]
    x, y = (u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px
    true = rig.focal_px * rig.baseline_m * (np.stack([x, y, np.ones_like(x)], axis=-1) @ normal) / 1.2
    # interpolated ones are exact on a plane; at the border the nearest pixel is taken
    assert np.median(np.abs(found.disparity_px - true)[known]) < 1e-4
    assert np.abs(found.disparity_px - true)[known].max() < 0.06


def test_resampling_never_mixes_two_surfaces_and_an_ideal_camera_is_not_resampled() -> None:
    rectifier = rectifier_of(K, DIST, 0.1)
    depth = np.full((120, 160), 1.0, dtype=np.float32)
    depth[:, 80:], depth[50:60, 30:40] = 1.6, np.nan
    found = measured_disparity(depth, RangeModel(1e-4, 0.003), rectifier)
    scale = rectifier.rig.focal_px * rectifier.rig.baseline_m
    near = np.minimum(abs(found.disparity_px - scale), abs(found.disparity_px - scale / 1.6))
    assert np.nanmax(near) < 1e-4
    ideal = rectifier_of(
        np.diag([150.0, 150.0, 1.0]) + np.outer([79.5, 59.5, 0.0], [0.0, 0.0, 1.0]), np.zeros(4), 0.2
    )
    assert ideal.maps is None
    ranges = np.random.default_rng(1).uniform(0.5, 2.0, (120, 160)).astype(np.float32)
    found = measured_disparity(ranges, RangeModel(1e-4, 0.003), ideal)
    np.testing.assert_allclose(found.disparity_px, 30.0 / ranges, rtol=1e-6)
    np.testing.assert_allclose(found.sigma_px, 30.0 / ranges**2 * 0.003, rtol=1e-6)
