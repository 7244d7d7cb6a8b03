"""The camera against OpenCV's models, its sensor against its laws: photon transfer, blur, wells, bits."""

import cv2
import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.files.images import bit_depth, to_grey
from polhode.runtime.errors import InputError
from polhode.simulation.stereo_camera import (
    build_cameras,
    expose,
    sample_offsets,
    sample_times,
    spill,
    through_lens,
    vignette,
)

TOED_IN_RIG = config.Rig(
    distortion=(-0.21, 0.06, 8e-4, -5e-4), principal_offset_px=(6, -4), right_rotation_deg=(0.5, -6, 0.8)
)


def test_rays_project_back_to_their_pixels_through_opencvs_models() -> None:
    left, _ = build_cameras(TOED_IN_RIG)
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
    left, _ = build_cameras(TOED_IN_RIG)
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


RNG = np.random.default_rng
IDEAL = config.Sensor(
    white_dn=200, read_noise_dn=0, black_level_dn=0, blur_px=0, vignetting=0, electrons_per_dn=1e5
)


def _sensor(**changes: object) -> config.Sensor:
    return IDEAL.model_copy(update=changes)


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("mean_dn", [20.0, 100.0, 200.0])
def test_variance_grows_with_the_signal_from_that_of_reading(bits: int, mean_dn: float) -> None:
    """The photon transfer curve: mean / gain + read noise^2 + quantisation / 12."""
    sensor = _sensor(electrons_per_dn=10, read_noise_dn=1.5, bits=bits)
    step_dn = 255 / (2**bits - 1)
    image = expose(np.full((300, 300), mean_dn / 200), sensor, RNG(0)) * step_dn
    assert image.mean() == pytest.approx(mean_dn, abs=0.1)
    assert image.var() == pytest.approx(mean_dn / 10 + 1.5**2 + step_dn**2 / 12, rel=0.02)


def test_read_noise_and_black_level_show_in_the_dark_and_clip_below_zero() -> None:
    image = expose(np.zeros((300, 300)), _sensor(read_noise_dn=2, black_level_dn=20), RNG(0)).astype(float)
    assert image.mean() == pytest.approx(20, abs=0.05)
    assert image.std() == pytest.approx(np.sqrt(4 + 1 / 12), rel=0.02)
    sensor = _sensor(read_noise_dn=0.8, black_level_dn=-3)
    assert (expose(np.zeros((480, 640)), sensor, RNG(0)) > 0).mean() < 1e-4


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_a_grey_value_is_the_same_share_of_full_scale_at_any_depth(bits: int) -> None:
    full = expose(np.full((20, 20), 1e30), _sensor(bits=bits), RNG(0))
    assert full.dtype.itemsize == (1 if bits == 8 else 2) and (full == 2**bits - 1).all()
    level = np.linspace(0, 1.2, 512)[None]
    image = expose(level, _sensor(bits=bits), RNG(0))
    np.testing.assert_allclose(image * (255 / (2**bits - 1)), level * 200, atol=0.6)
    grey = to_grey(image, bit_depth(int(image.max())))
    np.testing.assert_allclose(grey, level * 200, atol=1.1)


def test_glare_and_vignetting_take_their_shares_and_points_are_not_blurred_again() -> None:
    assert (expose(np.full((20, 20), 5.0), _sensor(full_well_dn=120.0), RNG(0)) == 120).all()
    level = np.zeros((161, 161))
    level[80, 80] = 100.0
    light = through_lens(level, _sensor(glare=0.2, glare_px=12.0))
    v, u = np.mgrid[-80:81, -80:81]
    halo = (u != 0) | (v != 0)
    assert light.sum() == pytest.approx(100, rel=1e-6)
    assert light[80, 80] == pytest.approx(80, rel=1e-2)
    assert np.sqrt((light * u**2)[halo].sum() / 20) == pytest.approx(12, rel=0.01)
    share = vignette(61, 81, 0.3)
    assert share[30, 40] == 1.0
    assert [share[0, 0], share[60, 80]] == pytest.approx([0.7, 0.7])
    assert 1 - share[30, 80] == pytest.approx(4 * (1 - share[30, 60]))
    light = through_lens(np.ones((61, 81)), _sensor(vignetting=0.3))
    np.testing.assert_allclose(light, share)
    points = np.zeros((21, 21))
    points[10, 10] = 0.5
    light = through_lens(np.zeros((21, 21)), _sensor(blur_px=1.0), points)
    np.testing.assert_array_equal(light, points)


@pytest.mark.parametrize("sigma_px", [0.3, 0.4, 1.5])
def test_the_lens_spreads_light_by_its_sigma_and_loses_none(sigma_px: float) -> None:
    level = np.zeros((41, 41))
    level[20, 20] = 100.0
    light = through_lens(level, _sensor(blur_px=sigma_px))
    u = np.arange(41) - 20
    assert light.sum() == pytest.approx(100, rel=1e-9)
    assert np.sqrt((light.sum(axis=0) * u**2).sum() / 100) == pytest.approx(sigma_px, rel=1e-3)


def test_bloom_is_even_to_both_sides_conserves_its_share_and_drains_at_the_ends() -> None:
    charge = RNG(3).uniform(0, 400, (200, 30))
    charge[95:105, 10:14] = 2000.0
    excess = np.maximum(charge - 500, 0).sum()
    for share in (0.0, 0.3, 1.0):
        wells = spill(charge, 500.0, share)
        assert wells.max() <= 500
        assert (wells >= np.minimum(charge, 500) - 1e-9).all()
        assert wells.sum() == pytest.approx(charge.sum() - (1 - share) * excess, rel=1e-12)
    charge = np.zeros((41, 5))
    charge[20, 2] = 100 + 10 * 100.0
    wells = spill(charge, 100.0, 0.6)
    np.testing.assert_allclose(wells[:, 2], wells[::-1, 2])
    np.testing.assert_allclose(wells[17:24, 2], 100.0)
    assert (wells[:, [0, 1, 3, 4]] == 0).all()
    np.testing.assert_allclose(wells.sum(), 100 + 0.6 * 1000)
    charge = np.zeros((5, 1))
    charge[2] = 1e6
    np.testing.assert_allclose(spill(charge, 100.0, 1.0), 100.0)
