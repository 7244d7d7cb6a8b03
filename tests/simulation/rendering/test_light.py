"""Lights, the eclipse, discs in the sky and patterns of samples against closed forms and counting."""

import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.geometry.lie import exp_so3, inverse_pose, make_pose
from polhode.simulation.rendering.light import disc_irradiance, lights_in_body, sunlight
from polhode.simulation.rendering.sampling import (
    Stratum,
    even_directions,
    rays_over_disc,
    scattered_offsets,
)
from polhode.simulation.stereo_camera import sample_offsets, sample_times

ECLIPSE = config.Light(eclipse=config.Eclipse(start_s=10.0, duration_s=8.0, ramp_s=2.0))


def test_the_eclipse_is_dark_for_its_duration_fades_smoothly_and_spares_the_lamp() -> None:
    assert [sunlight(ECLIPSE, t) for t in (0.0, 8.0, 20.0, 99.0)] == [1.0] * 4
    assert [sunlight(ECLIPSE, t) for t in (10.0, 14.0, 18.0)] == [0.0] * 3
    assert sunlight(ECLIPSE, 9.0) == sunlight(ECLIPSE, 19.0) == pytest.approx(0.5)
    assert sunlight(config.Light(), 10.0) == 1.0
    share = np.array([sunlight(ECLIPSE, t) for t in np.linspace(8.0, 10.0, 201)])
    slope = np.diff(share)
    assert (slope < 0).all()
    assert max(abs(slope[0]), abs(slope[-1])) < 0.15 * np.abs(slope).max()
    light = ECLIPSE.model_copy(update={"lamp": 0.4})
    lights = lights_in_body(light, np.eye(4), np.eye(4), 12.0)
    assert (lights.sun, lights.earth, lights.lamp) == (0.0, 0.0, 0.4)


def test_coarse_lights_are_near_and_change_seldom() -> None:
    light = config.Light(lamp=0.3)
    turns = [make_pose(exp_so3([0.0, angle, 0.1]), [0.0, 0.0, 0.6]) for angle in np.linspace(0.0, 0.02, 41)]
    exact = [lights_in_body(light, inverse_pose(X), inverse_pose(X)) for X in turns]
    coarse = [lights.quantized(1 / 256, 0.001) for lights in exact]
    assert len({lights.key for lights in exact}) == 41
    assert len({lights.key for lights in coarse}) < 30
    for near, lights in zip(coarse, exact, strict=True):
        assert near.sun_direction_G @ lights.sun_direction_G > np.cos(np.deg2rad(0.25))
        assert np.abs(near.lamp_G - lights.lamp_G).max() < 0.00051
        assert near.sun == lights.sun


UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("radius_deg", [30.0, 66.0])
def test_irradiance_of_a_disc_is_that_of_counted_directions(radius_deg: float) -> None:
    """Also where the horizon cuts it, and none when it is below."""
    sky = even_directions(400_000)
    inside = sky[sky @ UP > np.cos(np.deg2rad(radius_deg))]
    tilt = np.deg2rad([0.0, 25.0, 60.0, 88.0, 95.0, 120.0, 170.0])
    normals = np.stack([np.sin(tilt), np.zeros_like(tilt), np.cos(tilt)], axis=1)
    counted = 4.0 / len(sky) * np.maximum(inside @ normals.T, 0.0).sum(axis=0)
    np.testing.assert_allclose(disc_irradiance(np.cos(tilt), np.deg2rad(radius_deg)), counted, atol=1e-4)


@pytest.mark.parametrize("samples", [1, 16])
def test_rays_cover_the_disc_evenly(samples: int) -> None:
    """Any straight cut leaves on each side the share of rays that it leaves of the disc's area."""
    direction, radius_rad = np.array([0.6, 0.0, 0.8]), 0.02
    pixel = np.arange(4000)
    rays = [rays_over_disc(direction, radius_rad, Stratum(pixel, i, samples)) for i in range(samples)]
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=1e-12)
    assert (np.stack(rays) @ direction).min() > np.cos(radius_rad) - 1e-12
    for across in (np.array([0.0, 1.0, 0.0]), np.array([0.8, 0.0, -0.6])):
        x = np.stack(rays) @ across / radius_rad
        for cut in (-0.5, 0.0, 0.5):
            share = (np.arccos(cut) - cut * np.sqrt(1.0 - cut**2)) / np.pi
            assert (x > cut).mean() == pytest.approx(share, abs=0.02)


def test_samples_of_a_pixel_are_spread_and_the_same_every_time() -> None:
    """The number of 16 rays on one side of a cut through the middle varies less than a binomial."""
    pixel = np.arange(2000)
    rays = [rays_over_disc(UP, 0.02, Stratum(pixel, i, 16)) for i in range(16)]
    beyond = (np.stack(rays)[..., 0] > 0).sum(axis=0)
    assert beyond.std() < 0.5 * np.sqrt(16 * 0.25)
    first = rays_over_disc(UP, 0.02, Stratum(np.arange(100), 0, 4))
    again = rays_over_disc(UP, 0.02, Stratum(np.arange(50, 100), 0, 4))
    np.testing.assert_array_equal(first[50:], again)
    assert len(np.unique(first[:, 0])) == 100


@pytest.mark.parametrize("samples", [4, 16])
def test_scattered_rays_do_not_displace_an_edge(samples: int) -> None:
    """Of the regular pattern, edges of slope 1:2 are displaced: their pixels are covered by too much."""
    pixel, offsets = np.arange(20_000), sample_offsets(samples)
    normal = np.array([1.0, -2.0]) / np.sqrt(5.0)
    scattered = np.stack([scattered_offsets(pixel, offset, 0.0) for offset in offsets])
    covered = np.mean(scattered @ normal > 0.1)
    # the area of a unit square beyond a line, by counting
    fine = np.stack(np.meshgrid(*2 * [np.linspace(-0.4995, 0.4995, 1000)]), axis=-1)
    area = np.mean(fine @ normal > 0.1)
    assert covered == pytest.approx(area, abs=0.004)
    if samples == 4:
        assert abs(np.mean(offsets @ normal > 0.1) - area) > 0.08


def test_scattered_rays_stay_apart_and_say_nothing_of_their_moment() -> None:
    pixel, offsets, moment = np.arange(20_000), sample_offsets(4), sample_times(4)
    scattered = np.stack([scattered_offsets(pixel, offset, 0.0) for offset in offsets])
    assert np.abs(scattered).max() <= 0.5
    for axis in range(2):
        regular = np.corrcoef(offsets[:, axis], moment)[0, 1]
        place, when = scattered[..., axis].ravel(), np.repeat(moment, len(pixel))
        assert abs(np.corrcoef(place, when)[0, 1]) < 0.02 < abs(regular)
    pixel, offsets = np.arange(5000), sample_offsets(4)
    first = np.stack([scattered_offsets(pixel, offset, 0.0) for offset in offsets])
    away = np.abs(first[0] - first[1])
    apart = np.linalg.norm(np.minimum(away, 1.0 - away), axis=1)
    assert apart.min() > 0.4
    assert np.abs(first - [scattered_offsets(pixel, offset, 1.0) for offset in offsets]).mean() > 0.2
