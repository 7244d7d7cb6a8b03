"""Errors of the calibration, which the solution takes as right and its covariance does not."""

import numpy as np

from polhode.backend.dynamics.residuals import FrameStates
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.uncertainty.calibration_response import whitened_effects
from polhode.backend.uncertainty.covariance import Marginals, body_jacobians, marginals
from polhode.geometry.lie import Array, log_so3
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import BOX, at_truth, calibrated

SCENE = SyntheticScene(
    frames=30, landmarks=250, detection=0.5, w_G=(0.4, 0.5, 0.45), J_G=BOX, sigma_uv_px=0.1, sigma_d_px=0.1,
    accel_psd=1e-10, torque_psd=1e-10, links=False, camera_moves=True,
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
    sequence = generate(SCENE, 1)
    z = np.random.default_rng(2).normal(size=calibrated(sequence).tracks.calibration.left.shape[2])
    right, wrong = solved(calibrated(sequence)), solved(calibrated(sequence, 0.1 * z))
    m = marginals(
        right, np.ones(len(right.data.frame)), None, whitened_effects(right, calibrated(sequence).tracks)
    )
    (a, R_a), (b, R_b) = body_states(right), body_states(wrong)
    change = responses(right, m, m.by_calibration @ (0.1 * z[:, None]))[:, :, 0]
    for at in (slice(0, 3), slice(3, 6)):
        np.testing.assert_allclose((b - a)[:, at], change[:, at], atol=0.03 * np.abs(change[:, at]).max())
    # attitudes: G is free to turn, alike in all frames
    turn = log_so3(np.swapaxes(R_a, 1, 2) @ R_b)
    free = np.mean(turn - change[:, 6:9], axis=0)
    assert np.abs(turn - change[:, 6:9] - free).max() < 0.05 * np.abs(change[:, 6:9]).max()
