"""Disparity refinement against warps of known disparity, and stereo matching against known surfaces."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from polhode.config.frontend_settings import Features
from polhode.frontend.features.keypoints import KeyPoints, detect
from polhode.frontend.features.patches import image_jacobian, surface_normals
from polhode.frontend.features.stereo import (
    StereoFeatures,
    match_on_lines,
    match_stereo,
    refine_disparity,
    texture_sigma,
    with_rough_axes,
)
from polhode.frontend.rectification import Crop, Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array

RIG = RectifiedRig(467.0, 159.5, 119.5, 0.09, 320, 240)


def texture(seed: int) -> Array:
    """Band-limited noise (240, 320), as a lens would leave it."""
    noise = np.random.default_rng(seed).uniform(0, 255, (240, 320))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.6)
    return np.asarray(np.clip((smooth - smooth.mean()) * 3.0 + 120.0, 5, 250), dtype=np.float64)


def plane_at(uv: Array, slope: float) -> Array:
    return np.asarray(40.3 + slope * (uv[:, 0] - 160) + 0.05 * (uv[:, 1] - 120))


def stereo_pair(seed: int, slope: float, gain: float = 1.0) -> tuple[Image, Image]:
    """Left and right image of a plane slanted by ``slope`` px/px."""
    right = texture(seed)
    v, u = np.mgrid[0:240, 0:320].astype(np.float64)
    source = (u - (40.3 + slope * (u - 160) + 0.05 * (v - 120))).astype(np.float32)
    # Lanczos on a band-limited texture errs below the noise.
    left = cv2.remap(right.astype(np.float32), source, v.astype(np.float32), cv2.INTER_LANCZOS4)
    rng = np.random.default_rng(seed + 100)
    noisy = [np.round(a + rng.normal(0, 1.5, a.shape)) for a in (gain * left, right)]
    return np.clip(noisy[0], 0, 255).astype(np.uint8), np.clip(noisy[1], 0, 255).astype(np.uint8)


def matched(left: Image, right: Image, rig: RectifiedRig = RIG) -> tuple[StereoFeatures, Array]:
    whole = Crop(0, 0, 320, 240)
    points = [detect(image, np.ones(image.shape, dtype=bool), whole, Features()) for image in (left, right)]
    return match_stereo(left, right, points[0], points[1], rig)


@pytest.mark.parametrize(("slope", "gain"), [(0.0, 1.0), (0.15, 1.0), (-0.2, 0.7)])
def test_refined_disparity_is_unbiased_and_its_sigma_is_true(slope: float, gain: float) -> None:
    rng = np.random.default_rng(5)
    uv = np.column_stack([rng.uniform(110, 300, 400), rng.uniform(20, 220, 400)])
    truth = plane_at(uv, slope)
    start = truth + rng.uniform(-0.8, 0.8, 400)
    refined, sigma, correlation, _ = refine_disparity(*stereo_pair(3, slope, gain), uv, start)
    good = correlation > 0.9
    error = (refined - truth)[good]
    assert good.mean() > 0.95
    assert abs(np.median(error)) < 0.01
    assert 1.4826 * np.median(np.abs(error)) < 0.06
    assert 0.6 < 1.4826 * np.median(np.abs(error / sigma[good])) < 1.6


@pytest.mark.parametrize("noise", [1.5, 3.0])
def test_the_sigma_of_a_texture_is_that_of_two_images_of_it(noise: float) -> None:
    rng = np.random.default_rng(4)
    seen = 110.0 + np.linspace(0.1, 1.0, 320) * (texture(6) - 120.0)
    left, right = (
        np.clip(np.round(seen + rng.normal(0.0, noise, seen.shape)), 0, 255).astype(np.uint8)
        for _ in range(2)
    )
    uv = np.column_stack([rng.uniform(20, 300, 400), rng.uniform(20, 220, 400)])
    _, by_two, _, _ = refine_disparity(left, right, uv, np.zeros(400))
    by_one = texture_sigma(left, uv)
    assert 0.8 < np.median(by_one / by_two) < 1.2
    assert np.corrcoef(np.log(by_one), np.log(by_two))[0, 1] > 0.9
    assert texture_sigma(left, np.zeros((0, 2))).shape == (0,)


def test_images_without_texture_give_no_features() -> None:
    flat = np.full((240, 320), 100, dtype=np.uint8)
    noisy = (flat + np.random.default_rng(0).integers(0, 3, flat.shape)).astype(np.uint8)
    _, _, correlation, _ = refine_disparity(noisy, flat, np.array([[160.0, 120.0]]), np.array([40.0]))
    assert correlation[0] < 0.85
    black = np.zeros((240, 320), dtype=np.uint8)
    assert len(matched(black, black)[0]) == 0


@pytest.mark.parametrize(("second", "kept"), [(0.55, True), (0.52, False)])
def test_a_match_is_refused_when_the_second_best_descriptor_is_nearly_as_near(
    second: float, kept: bool
) -> None:
    """At a distance of 0.5 of the best one and a ratio of 0.95, the limit is at 0.526."""
    turn = 2.0 * np.arcsin(0.5 * np.array([0.0, 0.5, second]))
    looks = np.stack([np.cos(turn), np.sin(turn)], axis=1).astype(np.float32)
    uv = np.array([[200.0, 100.0], [160.0, 100.0], [150.0, 100.0]])
    points = [KeyPoints(uv[k], np.full(n, 2.0), np.zeros(n), looks[k]) for k, n in (([0], 1), ([1, 2], 2))]
    left, disparity = match_on_lines(points[0], points[1], RIG)
    assert (left.tolist(), disparity.tolist()) == (([0], [40.0]) if kept else ([], []))


@pytest.mark.parametrize("shift_px", [40.0, 0.0, -40.0])
def test_converging_cameras_match_what_both_see(shift_px: float) -> None:
    """Where the axes cross, columns agree, and the disparity beyond that of infinity exceeds the image."""
    left, right = stereo_pair(7, 0.0)
    right = np.roll(right, int(40.0 - shift_px), axis=1)
    near, _ = matched(left, right, replace(RIG, disparity_offset_px=-554.0))
    assert len(near) > 200
    assert abs(np.median(near.uvd_px[:, 2]) - shift_px) < 1.0
    np.testing.assert_allclose(np.median(near.p_R[:, 2]), 467.0 * 0.09 / (shift_px + 554.0), rtol=0.01)


def test_parallel_cameras_see_nothing_nearer_than_their_images_overlap() -> None:
    looks = np.eye(2, dtype=np.float32)
    uv = np.array([[300.0, 100.0], [300.0, 50.0]])
    shift = np.array([[0.69 * RIG.width_px, 0.0], [0.71 * RIG.width_px, 0.0]])
    left, right = (KeyPoints(at, np.full(2, 2.0), np.zeros(2), looks) for at in (uv, uv - shift))
    assert match_on_lines(left, right, RIG)[0].tolist() == [0]


@pytest.mark.parametrize("slope", [0.0, 0.15])
def test_matches_lie_on_the_surface_and_know_roughly_how_it_lies(slope: float) -> None:
    measured, slopes = matched(*stereo_pair(7, slope))
    features = with_rough_axes(measured, slopes, RIG)
    uv, n = features.uvd_px[:, :2], len(features)
    assert n > 100 and not features.on_surface.any()
    assert (np.abs(features.uvd_px[:, 2] - plane_at(uv, slope)) > 0.5).mean() < 0.02
    np.testing.assert_allclose(RIG.project(features.p_R), features.uvd_px, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1.0, atol=1e-4)
    R_RS, angle, per_px = features.proposing_R_RS, features.angle_rad, features.metres_per_px
    assert R_RS is not None and angle is not None and per_px is not None
    np.testing.assert_allclose(np.swapaxes(R_RS, 1, 2) @ R_RS, np.tile(np.eye(3), (n, 1, 1)), atol=1e-9)
    plane = np.column_stack([plane_at(uv, slope), np.tile([slope, 0.05], (n, 1))])
    cosine = np.sum(R_RS[:, :, 2] * surface_normals(uv, plane, RIG), axis=1)
    assert np.median(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))) < 12.0
    # x of the surface is seen along the key point's orientation
    seen = np.einsum("nij,nj->ni", image_jacobian(features.p_R, RIG), R_RS[:, :, 0])
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    np.testing.assert_allclose(seen, np.column_stack([np.cos(angle), np.sin(angle)]), atol=1e-9)
    jacobian = RIG.triangulation_jacobian(features.p_R)
    np.testing.assert_allclose(per_px, np.abs(jacobian[:, [0, 2], [0, 2]]))
