"""Frames that continue the motion, or do not: wrong stamps, pushes, maps that are lost."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.dynamics.process_noise import whitening
from polhode.backend.window.causal_state import OnlineState
from polhode.backend.window.estimator import SlidingWindow
from polhode.backend.window.frame import frames_of
from polhode.backend.window.judge import Judgement
from polhode.backend.window.problem import DisturbanceLevels, whitened_steps
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, inverse_pose, log_so3
from polhode.simulation.monte_carlo import SyntheticSequence, generate
from tests.backend.window.conftest import TUMBLE, Feed

JUMP_AT = 25
SPIN = replace(TUMBLE, frames=34, J_G=np.diag([1.5, 1.2, 0.9]), w_G=(1.3, 0.0, 0.0), v_N=(0.0, 0.0, 0.0))
Judged = tuple[SlidingWindow, list[OnlineState], list[Judgement]]


def judged(sequence: SyntheticSequence, jump_s: float = 0.0, only: bool = False) -> Judged:
    """The window after stamps that jump at ``JUMP_AT``, for good or in one ``only``; its states, in order."""
    config = Backend.model_validate({"process_noise": "given", "window": {"solver": "gauss_newton"}})
    window, states, said, latest = SlidingWindow(sequence.tracks.rig, config), [], [], -1
    for k, m in enumerate(frames_of(sequence.tracks)):
        off = jump_s if k == JUMP_AT or (k > JUMP_AT and not only) else 0.0
        m = replace(m, timestamp_ns=m.timestamp_ns + round(1e9 * off))
        if m.timestamp_ns > latest:
            latest = m.timestamp_ns
            states.append(window.add(m))
            said.append(window.judgement)
    return window, states, said


@pytest.fixture(scope="module")
def undisturbed(tumble: SyntheticSequence) -> Judged:
    return judged(tumble)


def test_innovations_have_the_covariance_that_is_stated(tumble: SyntheticSequence, feed: Feed) -> None:
    squared = []
    for seed in range(2):
        window, _ = feed(generate(TUMBLE, seed), solver="gauss_newton")
        squared += [fit.squared for fit in window._judge._agreed]
    # 2 x 24 frames, six degrees of freedom each: the mean of chi-squared over 6 is 1 +- 0.083
    assert len(squared) == 48 and 0.7 < np.mean(squared) / 6.0 < 1.3


@pytest.mark.parametrize("jump_s", [7.3, -3.0, 0.05])
def test_a_jump_of_the_clock_is_found_and_the_state_goes_on(
    tumble: SyntheticSequence, undisturbed: Judged, jump_s: float
) -> None:
    _, free, quiet = undisturbed
    window, states, said = judged(tumble, jump_s)
    assert all(each.consistent for each in quiet[5:])
    n = JUMP_AT
    assert [each.consistent for each in said[n - 1 : n + 3]] == [True, False, True, True]
    assert f"{jump_s:+.1f}"[:3] in said[n + 1].reason and "re-timed" in said[n + 1].reason
    assert abs(window._judge.offset_s + jump_s) < 0.01
    assert states[-1].timestamp_ns == round(1e9 * jump_s) + free[-1].timestamp_ns
    sigma = np.sqrt(np.diagonal(states[-1].covariance))
    assert (np.abs(states[-1].r_N - free[-1].r_N) < sigma[:3]).all()
    assert (np.abs(states[-1].w_P - free[-1].w_P) < sigma[9:]).all() and (sigma[9:] < 0.01).all()


def test_a_jump_too_small_to_tell_leaves_the_state_within_its_sigmas(
    tumble: SyntheticSequence, undisturbed: Judged
) -> None:
    _, free, _ = undisturbed
    _, states, said = judged(tumble, 0.006)
    assert all(each.consistent and not each.reason for each in said[5:])
    for k in range(JUMP_AT, len(states)):
        sigma = np.sqrt(np.diagonal(states[k].covariance))[9:]
        assert (np.abs(states[k].w_P - free[k].w_P) < 3.0 * sigma).all()


def test_one_wrong_stamp_is_not_a_jump(tumble: SyntheticSequence) -> None:
    window, _, said = judged(tumble, -0.2, only=True)
    assert not said[JUMP_AT].consistent and "alone" in said[JUMP_AT + 1].reason
    assert window._judge.offset_s == pytest.approx(0.0, abs=1e-12)


def test_whole_revolutions_are_left_open() -> None:
    window, _, said = judged(generate(SPIN, 0), -0.4)
    assert not said[JUMP_AT].consistent and "revolutions look alike" in said[JUMP_AT].reason
    assert " or " in said[JUMP_AT].reason and window._judge.offset_s == pytest.approx(0.4, abs=0.01)
    assert window.state.active.recent[JUMP_AT - len(said)].doubts[0] > 4.0


@pytest.mark.parametrize("torque", [(0.5, 0.0, 0.0), (0.0, 0.4, -0.3)])
def test_a_push_is_not_taken_for_a_jump(torque: tuple[float, float, float]) -> None:
    # for 0.3 s; the first one along the axis of rotation, as a jump of the clock would show
    start_s = (JUMP_AT - 1) * SPIN.dt_s + 0.1
    sequence = generate(replace(SPIN, pushes=((start_s, 0.3, (0.0, 0.02, 0.0), torque),)), 1)
    window, states, said = judged(sequence)
    assert not said[JUMP_AT].consistent and window._judge.offset_s == pytest.approx(0.0, abs=1e-12)
    assert any("a force, a torque" in each.reason for each in said[JUMP_AT:])
    rate, true = (np.linalg.norm(w_P) for w_P in (states[-1].w_P, sequence.truth.w_P[-1]))
    assert abs(rate - true) < 5.0 * window.sigma_rate


def test_doubts_of_a_step_are_in_its_covariance() -> None:
    w, J, dt, noise = np.array([[0.4, 0.5, 0.45]]), np.diag([1.5, 1.2, 0.9]), np.array([0.5]), (1e-6, 1e-6)
    step = whitened_steps(w, J, J, dt, DisturbanceLevels(*noise), np.array([[0.1, 2e-3, 3e-3, 0.02]]))
    # white noise over the step changes velocities by its square root times the length
    W_t, W_r, _ = whitening(w, J, dt, 1e-6 + 4e-6 / 0.5, 1e-6 + 9e-6 / 0.5)

    def covariance(W: Array) -> Array:
        return np.asarray(np.linalg.inv(W[0].T @ W[0]))

    of_time = covariance(step.W_t) - covariance(W_t)
    np.testing.assert_allclose(of_time, [[(0.1 * 0.02) ** 2, 0.0], [0.0, 0.0]], atol=1e-9)
    added = covariance(step.W_r) - covariance(W_r)
    values, vectors = np.linalg.eigh(added)
    # one direction: along the rate at the end of the step, whose size the torque-free motion nearly keeps
    assert values[-2] < 1e-9 < values[-1] and abs(np.sqrt(np.trace(added[:3, :3])) - 0.1 * 0.7826) < 0.002
    assert abs(vectors[:3, -1] @ w[0]) > 0.95 * np.linalg.norm(w[0]) * np.linalg.norm(vectors[:3, -1])


def test_a_new_frame_after_the_map_was_lost_is_where_the_old_map_says(tumble: SyntheticSequence) -> None:
    window, states, _ = judged(tumble)
    assert window.frame is not None and window.frame.name == "G@0" and window.frame.X_before is None
    *_, m = frames_of(tumble.tracks)
    axes = window._axes
    again = window._restart(m, 20.0, "by the test")
    frame, X_true = window.frame, tumble.X_NG
    assert (
        frame.name == f"G@{m.timestamp_ns}"
        and frame.before == "G@0"
        and frame.words in window.judgement.reason
    )
    assert frame.X_before is not None and frame.covariance is not None and not window.judgement.consistent
    # of each frame G in the body, by the pair that fixed it
    first, second = inverse_pose(X_true[0]) @ states[0].X_NG, inverse_pose(X_true[-1]) @ again.X_NG
    off = inverse_pose(frame.X_before) @ inverse_pose(first) @ second
    sigma = np.sqrt(np.diagonal(frame.covariance))
    assert np.linalg.norm(off[:3, 3]) < 5.0 * np.linalg.norm(sigma[:3]) < 0.01
    assert np.linalg.norm(log_so3(off[:3, :3])) < 5.0 * np.linalg.norm(sigma[3:]) < 0.05
    np.testing.assert_allclose(frame.X_before[:3, :3] @ window._axes, axes, atol=1e-12)
