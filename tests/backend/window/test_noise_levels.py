"""Noise levels from the frames of the window: of the pixels, and of the disturbances."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.window.solve import Grid, estimate_levels, estimate_noise, most_likely
from polhode.simulation.monte_carlo import generate
from tests.backend.window.conftest import TUMBLE, Feed


def bowl(centre: Grid, width: float) -> Callable[[Grid], float]:
    def minus_log_evidence(at: Grid) -> float:
        return ((at[0] - centre[0]) ** 2 + (at[1] - centre[1]) ** 2) / width**2

    return minus_log_evidence


def test_a_clear_optimum_is_found() -> None:
    for centre in ((0, 0), (-5, -3), (-8, 2)):
        assert most_likely(bowl(centre, 0.2)) == centre


def test_levels_that_the_data_do_not_tell_apart_are_as_large_as_stated() -> None:
    assert most_likely(bowl((-6, -6), 20.0)) == (0, 0)


def test_disturbances_of_a_simulated_tumble_are_recovered(feed: Feed) -> None:
    scene = replace(TUMBLE, accel_psd=1e-8, torque_psd=1e-7)
    window, _ = feed(generate(scene, 2))
    assert window.state.history is not None
    estimate_levels(window.state, window.state.history, (1e-6, 1e-6))
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
