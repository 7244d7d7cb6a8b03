"""Noise of the sensor against its statistics."""

import numpy as np
import pytest

from polhode.config import scene as config
from simulation.sensor import expose

RNG = np.random.default_rng


def test_shot_noise_grows_with_the_root_of_the_signal() -> None:
    sensor = config.Sensor(white_dn=200, electrons_per_dn=10, read_noise_dn=0, black_level_dn=0, blur_px=0)
    image = expose(np.full((300, 300), 0.5), sensor, RNG(0)).astype(float)
    assert image.mean() == pytest.approx(100, abs=0.1)
    # Quantisation adds 1/12.
    assert image.var() == pytest.approx(100 / 10 + 1 / 12, rel=0.03)


def test_read_noise_and_black_level_show_in_the_dark() -> None:
    sensor = config.Sensor(read_noise_dn=2, black_level_dn=20)
    image = expose(np.zeros((300, 300)), sensor, RNG(0)).astype(float)
    assert image.mean() == pytest.approx(20, abs=0.05)
    assert image.std() == pytest.approx(np.sqrt(4 + 1 / 12), rel=0.02)


def test_a_black_level_below_zero_clips_the_sky_to_zero() -> None:
    sensor = config.Sensor(read_noise_dn=0.8, black_level_dn=-3)
    assert (expose(np.zeros((480, 640)), sensor, RNG(0)) > 0).mean() < 1e-4


def test_too_much_light_saturates() -> None:
    assert (expose(np.full((20, 20), 1e5), config.Sensor(), RNG(0)) == 255).all()


def test_blur_keeps_the_light() -> None:
    level = np.zeros((41, 41))
    level[20, 20] = 100.0
    sensor = config.Sensor(white_dn=20, electrons_per_dn=1e4, read_noise_dn=0, black_level_dn=0, blur_px=1.5)
    image = expose(level, sensor, RNG(0)).astype(float)
    u = np.arange(41) - 20
    spread = np.sqrt((image.sum(axis=0) * u**2).sum() / image.sum())
    assert image.sum() == pytest.approx(2000, rel=0.03)
    assert spread == pytest.approx(1.5, rel=0.05)
