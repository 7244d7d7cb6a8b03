"""Noise levels from the frames of the window: of the pixels, and of the disturbances."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.window.solve import estimate_levels, estimate_noise
from polhode.simulation.monte_carlo import generate
from tests.backend.window.conftest import TUMBLE, Feed


def test_disturbances_of_a_simulated_tumble_are_recovered(feed: Feed) -> None:
    scene = replace(TUMBLE, accel_psd=1e-8, torque_psd=1e-7)
    window, _ = feed(generate(scene, 2))
    assert window.state.history is not None
    estimate_levels(window.state, window.state.history)
    found = window.state.disturbances
    assert 1e-9 < found.accel_psd < 1e-7
    assert 1e-8 < found.torque_psd < 1e-6
    assert np.isfinite(window.state.active.constants).all()


def test_pixel_and_disparity_noise_are_recovered_among_outliers(feed: Feed) -> None:
    sequence = generate(
        replace(TUMBLE, frames=24, landmarks=1500, sigma_uv_px=0.4, sigma_d_px=0.2, outliers=0.05), 2
    )
    tracks = replace(sequence.tracks, sigma_px=np.ones_like(sequence.tracks.sigma_px))
    window, _ = feed(replace(sequence, tracks=tracks))
    estimate_noise(window.state)
    assert window.state.noise == pytest.approx([0.4, 0.4, 0.2], rel=0.1)
    for frame in window.state.active.frames:
        np.testing.assert_allclose(frame.inv_sigma, np.tile(1.0 / window.state.noise, (len(frame.slot), 1)))
