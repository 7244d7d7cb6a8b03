"""The arrival cost made from a history is the history: same optimum, same information."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.window.estimator import SlidingWindow
from polhode.backend.window.solve import solve_history, solve_window
from polhode.simulation.monte_carlo import generate
from tests.backend.window.conftest import TUMBLE, Feed


def remove_outliers(window: SlidingWindow) -> None:
    for _ in range(3):
        assert window.state.history is not None
        solve_history(window.state, window.state.history)


@pytest.mark.parametrize("sigma", [0.0, 5e-4])
def test_arrival_cost_stands_for_all_that_left(feed: Feed, sigma: float) -> None:
    scene = replace(TUMBLE, frames=20, sigma_camera_p_m=sigma, sigma_camera_theta_rad=sigma)
    window, _ = feed(generate(scene, 0), frames=5, key_frames=6, history=100)
    state = window.state
    assert len(state.active.keys) == 6 and state.history is not None
    remove_outliers(window)
    before, whole = state.active.vector(), state.last
    state.history.expand_arrival(state.active, state.prior.form, state.R_inertia)
    solve_window(state)
    assert whole is not None and state.last is not None
    sigma_now = np.sqrt(np.diag(np.linalg.inv(state.last.joint)))
    moved = np.abs(state.active.vector() - before)[-20:]
    assert np.all(moved < 0.02 * sigma_now)
    scale = np.outer(sigma_now, sigma_now)
    scaled, expected = state.last.joint * scale, whole.joint * scale
    np.testing.assert_allclose(scaled, expected, atol=2e-3 * np.abs(scaled).max())


def test_what_is_left_out_takes_only_its_own_pose_along(feed: Feed) -> None:
    window, _ = feed(generate(TUMBLE, 0), 30, frames=5, key_frames=6, history=100)
    active, history = window.state.active, window.state.history
    assert history is not None
    numbers = [frame.number for frame in history.frames]
    held = {numbers[0], *(frame.number for frame in active.frames)}
    before = history._H
    history.thin(active, 20)
    left = [frame.number for frame in history.frames]
    assert len(left) == 20 and held <= set(left) and history.n_added == 30
    at = (6 * np.array([numbers.index(n) for n in left])[:, None] + np.arange(6)).ravel()
    gone = np.setdiff1d(np.arange(len(before)), at)
    sure = before[np.ix_(gone, gone)]
    expected = (
        before[np.ix_(at, at)] - before[np.ix_(at, gone)] @ np.linalg.pinv(sure) @ before[np.ix_(gone, at)]
    )
    np.testing.assert_allclose(history._H, expected, atol=1e-6 * expected.max())


def test_a_motion_that_does_not_tell_the_inertia_keeps_a_bounded_history(feed: Feed) -> None:
    scene = replace(TUMBLE, w_G=(0.0, 0.0, 1.0), accel_psd=1e-9, torque_psd=1e-9)
    window, states = feed(generate(scene, 9), frames=5, key_frames=6, history=16)
    history = window.state.history
    assert history is not None and len(history.frames) == 16 and history.n_added == 40
    assert history.frames[0].number == 1
    gaps = np.diff([frame.number for frame in history.frames])
    assert gaps.max() < 9
    assert not states[-1].determined[:2].any()
