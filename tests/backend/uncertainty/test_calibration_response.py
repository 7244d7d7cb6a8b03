"""Errors of the calibration, which the solution takes as right and its covariance does not."""

from dataclasses import replace

import numpy as np

from polhode.backend.dynamics.residuals import FrameStates
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.uncertainty.calibration_response import whitened_effects
from polhode.backend.uncertainty.covariance import (
    DependentErrors,
    Marginals,
    body_jacobians,
    marginals,
)
from polhode.backend.window.estimator import estimate_online
from polhode.config.backend_settings import Backend, Window
from polhode.geometry.lie import Array, log_so3
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import (
    BOX,
    at_truth,
    calibrated,
    deviations,
    estimated,
    nees,
    state_errors,
    with_errors,
)

PARTS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
SCENE = SyntheticScene(
    frames=30, landmarks=250, detection=0.5, w_G=(0.4, 0.5, 0.45), J_G=BOX, sigma_uv_px=0.1, sigma_d_px=0.1,
    accel_psd=1e-10, torque_psd=1e-10, links=False, camera_moves=True,
)  # fmt: skip

CONFIG = Backend(
    solver="gauss_newton", process_noise="given", accel_psd=1e-10, torque_psd=1e-10,
    systematic_px=(0.0, 0.0, 0.0), light_px=0.0, window=Window(solver="gauss_newton"),
)  # fmt: skip


def solved(sequence: SyntheticSequence) -> MotionFit:
    """From the truth."""
    fit = at_truth(sequence)
    fit = fit.with_data(accel_psd=SCENE.accel_psd, torque_psd=SCENE.torque_psd, robust_scale=1e4)
    return fit.moved_to(GaussNewton(fit.data).solve(fit.linearized(), fit.iterate.vector(), 30).x)


def body_states(fit: MotionFit) -> tuple[Array, Array]:
    """r_N, v_N, w_N (F, 9), and R_NG (F, 3, 3)."""
    at = fit.iterate
    w_N = np.einsum("fij,fj->fi", at.R_NG, at.w_G)
    return np.hstack([FrameStates.of(at, fit.data.camera_N).centres(), at.v_N, w_N]), at.R_NG


def responses(fit: MotionFit, m: Marginals, factor: Array) -> Array:
    """Changes (F, 12, c) of r_N, v_N, theta_G, w_G by columns (s F + 8, c) of the unknowns."""
    s, n = fit.iterate.n_state, fit.iterate.n_states
    rows = [np.r_[s * k : s * k + s, n : n + 8] for k in range(fit.iterate.n_frames)]
    return np.stack([T @ factor[at] for T, at in zip(body_jacobians(fit.iterate), rows, strict=True)])


def test_the_solution_moves_as_the_response_says() -> None:
    sequence = calibrated(generate(SCENE, 1))
    other, z = with_errors(sequence, 2, size=0.1)
    right, wrong = solved(sequence), solved(other)
    d, effect = right.data, whitened_effects(right, sequence.tracks)
    m = marginals(right, np.ones(len(d.frame)), None, effect)
    # errors that depend on one another change the covariance, not the solution nor how it moves
    dependent = DependentErrors(
        np.full((len(d.frame), 3), 9.0), np.zeros((3, d.n_frames, d.n_frames)), np.zeros((len(d.frame), 3, 0))
    )
    with_more = marginals(right, np.ones(len(d.frame)), dependent, effect)
    np.testing.assert_allclose(with_more.by_calibration, m.by_calibration, rtol=1e-9, atol=1e-15)
    (a, R_a), (b, R_b) = body_states(right), body_states(wrong)
    change = responses(right, m, m.by_calibration @ z[:, None])[:, :, 0]
    for at in (slice(0, 3), slice(3, 6)):
        np.testing.assert_allclose((b - a)[:, at], change[:, at], atol=0.03 * np.abs(change[:, at]).max())
    # attitudes: G is free to turn, alike in all frames
    turn = log_so3(np.swapaxes(R_a, 1, 2) @ R_b)
    free = np.mean(turn - change[:, 6:9], axis=0)
    assert np.abs(turn - change[:, 6:9] - free).max() < 0.05 * np.abs(change[:, 6:9]).max()


def test_errors_drawn_from_the_prior_are_covered_and_without_the_calibration_they_are_not() -> None:
    scene = replace(SCENE, links=True, camera_moves=False)
    squares, within, missed, online_off = [], [], [], []
    for seed in range(3):
        wrong, _ = with_errors(calibrated(generate(scene, seed)), seed)
        found = estimated(wrong, CONFIG)
        assert found.calibration is not None
        errors, own = state_errors(wrong, found), found.calibration.last_joint[:12, :12]
        squares.append([nees(errors[:, at], found.covariance[:, at, at]) for at in PARTS])
        within.append(np.abs(deviations(wrong, found)) < 3.0)
        images = found.covariance[-1] - own
        assert np.linalg.eigvalsh(images)[0] > -1e-9 * np.trace(images)
        missed.append(np.abs(errors[-1, :3]) / np.sqrt(np.diag(images)[:3]))
        if seed == 0:
            online = estimate_online(wrong.tracks, CONFIG, Silent())
            off = np.concatenate([online.r_N[-1] - wrong.truth.r_N[-1], online.v_N[-1] - wrong.truth.v_N[-1]])
            online_off.append(off / np.sqrt(np.diag(online.covariance[-1])[:6]))
            ratio = np.sqrt(np.diag(online.covariance[-1]) / np.diag(found.covariance[-1]))
            assert (ratio > 0.8).all() and (ratio < 1.5).all()
    assert np.mean(within) >= 0.99 and np.abs(online_off).max() < 4.0
    assert (np.mean(squares, axis=0) > 0.1).all() and (np.mean(squares, axis=0) < 2.5).all()
    assert np.max(missed) > 5.0


def test_before_a_moving_camera_the_causal_velocity_has_the_part_that_the_response_has() -> None:
    sequence = calibrated(generate(replace(SCENE, links=True), 0))
    part = estimated(sequence, CONFIG).calibration
    assert part is not None
    tracks = sequence.tracks
    exact, online = (
        estimate_online(each, CONFIG, Silent()) for each in (replace(tracks, calibration=None), tracks)
    )
    own = np.sqrt(np.diagonal(online.covariance[-1] - exact.covariance[-1]))
    np.testing.assert_allclose(own[:3], np.sqrt(np.diag(part.last_joint))[:3], rtol=0.2)
    of_velocity = np.linalg.norm(own[3:6]) / np.linalg.norm(np.sqrt(np.diag(part.last_joint))[3:6])
    assert 0.7 < of_velocity < 1.5 and (own[6:] > 0.0).all()
