"""The arrival cost made from a history is the history: same optimum, same information."""

from dataclasses import replace

import numpy as np
import pytest

from backend.window.estimator import SlidingWindow
from backend.window.newton import NewtonSolver
from backend.window.steps import expand_arrival, solve_whole, solve_window
from simulation.measurements import generate
from tests.backend.window.conftest import TUMBLE, Feed


def settle(window: SlidingWindow) -> None:
    for _ in range(3):
        assert window.belief.history is not None
        solve_whole(window.belief, window.belief.history)


@pytest.mark.parametrize("sigma", [0.0, 5e-4])
def test_arrival_cost_stands_for_all_that_left(feed: Feed, sigma: float) -> None:
    scene = replace(TUMBLE, frames=20, sigma_camera_p_m=sigma, sigma_camera_theta_rad=sigma)
    window, _ = feed(generate(scene, 0), frames=5, key_frames=6, history=100)
    belief = window.belief
    assert len(belief.active.keys) == 6 and belief.history is not None
    settle(window)
    before, whole = belief.active.vector(), belief.last
    expand_arrival(belief, belief.history)
    solve_window(belief, NewtonSolver())
    assert whole is not None and belief.last is not None
    sigma_now = np.sqrt(np.diag(np.linalg.inv(belief.last.joint)))
    moved = np.abs(belief.active.vector() - before)[-20:]
    assert np.all(moved < 0.02 * sigma_now)
    scale = np.outer(sigma_now, sigma_now)
    scaled, expected = belief.last.joint * scale, whole.joint * scale
    np.testing.assert_allclose(scaled, expected, atol=2e-3 * np.abs(scaled).max())


def test_camera_noise_loosens_the_pose_and_not_the_velocity_by_as_much(feed: Feed) -> None:
    sigmas = []
    for sigma in (0.0, 1e-3):
        scene = replace(TUMBLE, frames=20, sigma_camera_p_m=sigma, sigma_camera_theta_rad=0.2 * sigma)
        _, states = feed(generate(scene, 1))
        sigmas.append(np.sqrt(np.diag(states[-1].covariance)))
    exact, noisy = sigmas
    assert np.all(noisy[:3] > exact[:3])
    assert np.all(noisy[3:6] < 2.0 * exact[3:6])
