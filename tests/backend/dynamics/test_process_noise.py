"""The process noise against closed forms, against an independent integrator, and for its conditioning."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from polhode.backend.dynamics.process_noise import (
    rotation_covariance_scaled,
    translation_covariance,
    whitening,
)
from polhode.geometry.lie import Array, hat


def rotation_covariance(w_G: Array, J_G: Array, dt_s: Array, torque_psd: float) -> Array:
    """Covariance (n, 6, 6) of (theta, w) after one step [rad^2, rad^2/s, rad^2/s^2]."""
    cov, scale = rotation_covariance_scaled(w_G, J_G, dt_s, torque_psd)
    return cov * scale[:, :, None] * scale[:, None, :]


def test_without_a_rate_both_are_double_integrators_and_the_torque_acts_on_the_moments() -> None:
    t, still = 0.7, np.zeros((1, 3))
    block = 2e-6 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
    np.testing.assert_allclose(translation_covariance(np.array([t]), 2e-6)[0], block)
    cov = rotation_covariance(still, np.eye(3), np.array([t]), 2e-6)[0]
    np.testing.assert_allclose(cov, np.kron(block, np.eye(3)), rtol=1e-9, atol=1e-18)
    # over the middle moment
    cov = rotation_covariance(still, np.diag([4.0, 2.0, 3.0]), np.array([0.1]), 1e-6)[0]
    np.testing.assert_allclose(np.diag(cov)[3:], 1e-7 * np.array([3 / 4, 3 / 2, 1.0]) ** 2, rtol=1e-9)


@pytest.mark.parametrize("dt_s", [1e-3, 0.1, 0.5, 10.0])
@pytest.mark.parametrize("moments", [(1.5, 1.2, 0.9), (2.41, 2.34, 2.01), (1.0, 0.6, 0.42)])
def test_covariance_solves_the_lyapunov_equation_at_every_step_and_rate(
    moments: tuple[float, float, float], dt_s: float
) -> None:
    J = np.diag(moments) / moments[1]
    for rate in (0.1, 2.1):
        for direction in ([1.0, 0.1, 0.05], [0.05, 1.0, 0.05], [0.6, 0.7, 0.5]):
            w = rate * np.array(direction) / np.linalg.norm(direction)
            cov = rotation_covariance_scaled(w[None], J, np.array([dt_s]), 1e-6)[0][0]
            L = np.linalg.cholesky(lyapunov(w, J, dt_s))
            whitened = np.linalg.solve(L, np.linalg.solve(L, cov).T)
            # variances to a thousandth in every direction, the smallest too
            np.testing.assert_allclose(np.linalg.eigvalsh(whitened), 1.0, atol=1e-3)


def lyapunov(w: Array, J: Array, dt_s: float) -> Array:
    """Eq. 4.58 scaled as the module scales it, by an integrator that it does not use."""
    J_inv, noise = np.linalg.inv(J), np.zeros((6, 6))
    noise[3:, 3:] = J_inv @ J_inv.T

    def derivative(_: float, y: Array) -> Array:
        A = np.zeros((6, 6))
        A[:3, :3], A[:3, 3:] = -hat(y[:3]) * dt_s, np.eye(3)
        A[3:, 3:] = J_inv @ (hat(J @ y[:3]) - hat(y[:3]) @ J) * dt_s
        flow = A @ y[3:].reshape(6, 6)
        w_dot = -J_inv @ np.cross(y[:3], J @ y[:3]) * dt_s
        return np.concatenate([w_dot, (flow + flow.T + noise).ravel()])

    start = np.concatenate([w, np.zeros(36)])
    solution = solve_ivp(derivative, (0.0, 1.0), start, "DOP853", rtol=1e-11, atol=1e-13)
    return np.asarray(solution.y[3:, -1]).reshape(6, 6)


def test_whitening_is_the_square_root_of_the_information_and_refuses_rates_beyond_all_bounds() -> None:
    w, J, dt = np.array([[0.3, 0.8, -0.2]]), np.diag([1.3, 1.0, 0.9]), np.array([0.5])
    W_t, W_r, half_log = whitening(w, J, dt, 1e-6, 3e-6)
    of_rotation, of_translation = rotation_covariance(w, J, dt, 3e-6)[0], translation_covariance(dt, 1e-6)[0]
    np.testing.assert_allclose(W_r[0] @ of_rotation @ W_r[0].T, np.eye(6), atol=1e-9)
    np.testing.assert_allclose(W_t[0] @ of_translation @ W_t[0].T, np.eye(2), atol=1e-9)
    log_det = np.linalg.slogdet(of_rotation)[1] + 3.0 * np.linalg.slogdet(of_translation)[1]
    assert half_log == pytest.approx(0.5 * log_det)
    for rate in (np.nan, np.inf, 1e9):
        with pytest.raises(np.linalg.LinAlgError, match="beyond all bounds"):
            whitening(np.array([[0.1, rate, 0.2]]), J, dt, 1e-6, 1e-6)
