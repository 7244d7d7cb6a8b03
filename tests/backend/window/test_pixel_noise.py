"""The noise of the pixels is recovered from what the window holds."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.window.pixel_noise import estimate_noise
from polhode.simulation.monte_carlo.measurements import generate
from tests.backend.window.conftest import TUMBLE, Feed


def test_pixel_and_disparity_noise_are_recovered_among_outliers(feed: Feed) -> None:
    sequence = generate(
        replace(TUMBLE, frames=24, landmarks=1500, sigma_uv_px=0.4, sigma_d_px=0.2, outliers=0.05), 2
    )
    tracks = replace(sequence.tracks, sigma_px=np.ones_like(sequence.tracks.sigma_px))
    window, _ = feed(replace(sequence, tracks=tracks))
    estimate_noise(window.belief)
    assert window.belief.noise == pytest.approx([0.4, 0.4, 0.2], rel=0.1)
    for frame in window.belief.active.frames:
        np.testing.assert_allclose(frame.inv_sigma, np.tile(1.0 / window.belief.noise, (len(frame.slot), 1)))
