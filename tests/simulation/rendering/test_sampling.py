"""Discs in the sky against closed forms and counting."""

import numpy as np
import pytest

from polhode.simulation.rendering.light import disc_irradiance
from polhode.simulation.rendering.sampling import (
    Stratum,
    even_directions,
    nearest_direction,
    nearest_direction_map,
    rays_over_disc,
    scattered_offsets,
)
from polhode.simulation.stereo_camera import sample_offsets, sample_times

UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("radius_deg", [5.0, 30.0, 66.0, 90.0])
def test_irradiance_of_a_disc_is_that_of_counted_directions(radius_deg: float) -> None:
    """Also where the horizon cuts it, and none when it is below."""
    sky = even_directions(400_000)
    inside = sky[sky @ UP > np.cos(np.deg2rad(radius_deg))]
    tilt = np.deg2rad([0.0, 25.0, 60.0, 88.0, 95.0, 120.0, 170.0])
    normals = np.stack([np.sin(tilt), np.zeros_like(tilt), np.cos(tilt)], axis=1)
    counted = 4.0 / len(sky) * np.maximum(inside @ normals.T, 0.0).sum(axis=0)
    np.testing.assert_allclose(disc_irradiance(np.cos(tilt), np.deg2rad(radius_deg)), counted, atol=1e-4)


def test_a_disc_overhead_gives_its_sine_squared() -> None:
    assert disc_irradiance(np.ones(1), np.deg2rad(66.0))[0] == pytest.approx(np.sin(np.deg2rad(66.0)) ** 2)


@pytest.mark.parametrize("samples", [1, 4, 16])
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


def test_the_map_of_directions_finds_one_of_the_nearest() -> None:
    directions = even_directions(1024)
    nearest = nearest_direction_map(directions)
    given = np.random.default_rng(0).normal(size=(500, 3))
    found = directions[[nearest_direction(vector[0], vector[1], vector[2], nearest) for vector in given]]
    cosine = np.einsum("nk,nk->n", found, given) / np.linalg.norm(given, axis=1)
    assert np.rad2deg(np.arccos(cosine)).max() < 7.0
    for index, direction in enumerate(directions[::97]):
        assert (
            nearest_direction(direction[0], direction[1], direction[2], nearest)
            in np.argsort(-directions @ direction)[:4]
        ), index


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
