"""Rays against OpenCV's projection."""

import cv2
import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.runtime.errors import InputError
from polhode.simulation.stereo_camera import build_cameras, sample_offsets, sample_times

RIG = config.Rig(
    distortion=(-0.21, 0.06, 8e-4, -5e-4), principal_offset_px=(6, -4), right_rotation_deg=(0.5, -6, 0.8)
)


def test_rays_project_back_to_their_pixels_through_opencvs_models() -> None:
    left, _ = build_cameras(RIG)
    uv = np.random.default_rng(0).uniform((0, 0), (639, 479), (500, 2))
    projected, _ = cv2.projectPoints(left.directions(uv) * 3.7, np.zeros(3), np.zeros(3), left.K, left.dist)
    np.testing.assert_allclose(projected[:, 0], uv, atol=1e-7)
    rig = config.Rig(lens="equidistant", distortion=(-0.028, 0.012, -0.009, 0.0016), focal_px=310)
    left, right = build_cameras(rig)
    uv = np.random.default_rng(0).uniform((0, 0), (639, 479), (500, 2))
    rays = left.directions(uv)
    projected, _ = cv2.fisheye.projectPoints(rays[:, None] * 3.7, np.zeros(3), np.zeros(3), left.K, left.dist)
    np.testing.assert_allclose(projected[:, 0], uv, atol=1e-7)
    seen, index = right.project_visible(right.directions(uv))
    np.testing.assert_allclose(seen, uv[index], atol=1e-7)
    assert len(index) == len(uv)


def test_a_distortion_that_folds_the_image_is_refused() -> None:
    left, _ = build_cameras(config.Rig(lens="equidistant", distortion=(-0.3, 0.0, 0.0, 0.0), focal_px=310))
    with pytest.raises(InputError, match="cannot be inverted over the whole image"):
        left.directions(np.array([[0.0, 0.0]]))
    left, _ = build_cameras(config.Rig(distortion=(-3.0, 0, 0, 0)))
    with pytest.raises(InputError, match="distortion cannot be inverted"):
        _ = left.pixel_directions


def test_cameras_are_those_of_the_rig() -> None:
    left, right = build_cameras(config.Rig(right_size_px=(320, 200), right_focal_px=200.0))
    assert (left.width_px, left.height_px, left.K[0, 0]) == (640, 480, 467.0)
    assert (right.width_px, right.height_px, right.K[0, 0]) == (320, 200, 200.0)
    np.testing.assert_allclose(right.K[:2, 2], [159.5, 99.5])
    left, _ = build_cameras(config.Rig(width_px=20, height_px=16, focal_px=30))
    rays = left.pixel_directions.reshape(16, 20, 3)
    u = 30 * rays[5, 7, 0] / rays[5, 7, 2] + 9.5
    v = 30 * rays[5, 7, 1] / rays[5, 7, 2] + 7.5
    assert (u, v) == pytest.approx((7, 5))
    _, right = build_cameras(config.Rig(right_rotation_deg=(0, -6, 0)))
    optical_axis_left = right.X_CK[:3, 2]
    assert optical_axis_left[0] < 0 < optical_axis_left[2]
    np.testing.assert_allclose(right.X_CK[:3, 3], [0.09, 0, 0])


@pytest.mark.parametrize("samples", [1, 4, 9, 16])
def test_samples_fill_every_row_and_column_of_a_pixel_once(samples: int) -> None:
    cells = np.round((sample_offsets(samples) + 0.5) * samples - 0.5, 9)
    if samples == 1:
        np.testing.assert_allclose(sample_offsets(1), 0.0)
        return
    assert (np.abs(sample_offsets(samples)) < 0.5).all()
    np.testing.assert_allclose(sample_offsets(samples).mean(axis=0), 0, atol=1e-12)
    for axis in (0, 1):
        assert len(np.unique(cells[:, axis])) == samples


@pytest.mark.parametrize(("samples", "largest"), [(4, 0.4), (9, 0.0), (16, 0.0)])
def test_moments_of_the_samples_fill_the_exposure_and_do_not_follow_their_place(
    samples: int, largest: float
) -> None:
    moments = sample_times(samples)
    np.testing.assert_allclose(np.sort(moments), (np.arange(samples) + 0.5) / samples - 0.5)
    for axis in (0, 1):
        assert abs(np.corrcoef(moments, sample_offsets(samples)[:, axis])[0, 1]) <= largest + 1e-9


def test_points_beside_and_behind_the_image_are_not_visible() -> None:
    left, _ = build_cameras(RIG)
    uv = np.array([[0.0, 0.0], [639.0, 479.0], [300.0, 200.0]])
    inside = left.directions(uv) * 2.0
    outside = np.array([[0.0, 0.0, -1.0], [5.0, 0.0, 1.0], [0.9, 0.0, 1.0], *-inside])
    pixels, index = left.project_visible(np.concatenate([outside, inside]))
    np.testing.assert_array_equal(index, 6 + np.arange(3))
    np.testing.assert_allclose(pixels, uv, atol=1e-6)
    left, _ = build_cameras(config.Rig(distortion=(-0.15, 0.0, 0.0, 0.0)))
    far = np.array([[2.5, 0.0, 1.0], [0.0, 2.45, 1.0]])
    assert (np.abs(left.project(far) - left.K[:2, 2]) < 200).all()
    assert len(left.project_visible(far)[1]) == 0
