"""Formulas of docs/mathematics.md, each against the code or a computation of another kind."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from polhode.backend.dynamics.process_noise import rotation_covariance_scaled
from polhode.backend.problem.inertia import (
    principal_axes,
)
from polhode.backend.solvers.robust_kernel import kernel_curvature, robust_cost, robust_weight
from polhode.geometry.lie import Array, hat, log_so3
from polhode.geometry.rigid_body import angular_acceleration, angular_momentum_N, propagate, rotational_energy

J = np.array([[1.3, 0.1, -0.05], [0.1, 1.0, 0.08], [-0.05, 0.08, 0.8]])
W = np.array([0.3, 0.9, -0.4])


def moved(J_A: Array, w: Array, times: Array) -> tuple[Array, Array]:
    """Attitudes (n, 3, 3) and rates (n, 3) of free motion from rest at the origin."""
    _, _, R, rates = propagate(times, np.zeros(3), np.zeros(3), np.eye(3), w, J_A)
    return R, rates


def test_d2_energy_and_momentum() -> None:
    R, w = moved(J, W, np.linspace(0.0, 20.0, 9))
    np.testing.assert_allclose(rotational_energy(J, w), 0.5 * W @ J @ W, rtol=1e-9)
    np.testing.assert_allclose(angular_momentum_N(J, R, w), np.tile(J @ W, (9, 1)), atol=1e-9)
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", w, J @ J, w), W @ J @ J @ W, rtol=1e-9)
    assert np.ptp(w, axis=0).min() > 0.01  # it does move


def test_d7_robust_kernel() -> None:
    c, h = 3.0, 1e-5
    for s in (0.1, 1.0, 4.0):
        slope = (robust_cost(np.array([s + h]), c) - robust_cost(np.array([s - h]), c)) / (2.0 * h)
        weight = float(robust_weight(np.array([s]), c)[0])
        assert weight == pytest.approx(2.0 * slope, rel=1e-6) == pytest.approx(1.0 / (1.0 + s / c**2))
        # whole while the limit does not act: the exact second derivative of the cost in the residual
        kappa = float(kernel_curvature(np.array([s]), c)[0])
        assert 2.0 * kappa - kappa**2 * s == pytest.approx(min(2.0 * weight / c**2, 0.6 / s), rel=1e-6)


def test_d9_white_torque() -> None:
    middle = np.linalg.eigvalsh(J)[1]
    J1, S, t = J / middle, 0.3, 0.8
    cov, scale = rotation_covariance_scaled(W[None], J, np.array([t]), S)
    found = cov[0] * np.outer(scale[0], scale[0])
    B = np.vstack([np.zeros((3, 3)), np.linalg.inv(J1)])

    def rate(_: float, y: Array) -> Array:
        w, L = y[:3], y[3:].reshape(6, 6)
        A = np.zeros((6, 6))
        A[:3, :3], A[:3, 3:] = -hat(w), np.eye(3)
        A[3:, 3:] = np.linalg.solve(J1, hat(J1 @ w) - hat(w) @ J1)
        change = A @ L + L @ A.T + S * B @ B.T
        return np.concatenate([angular_acceleration(J1, w), change.ravel()])

    solution = solve_ivp(rate, (0.0, t), np.concatenate([W, np.zeros(36)]), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found, solution.y[3:, -1].reshape(6, 6), rtol=1e-5, atol=1e-8)
    cov, scale = rotation_covariance_scaled(np.zeros((1, 3)), J, np.array([t]), S)
    at_rest = cov[0] * np.outer(scale[0], scale[0])
    inverse_square = np.linalg.inv(J1 @ J1)
    np.testing.assert_allclose(at_rest[:3, :3], S * inverse_square * t**3 / 3.0, rtol=1e-6)
    np.testing.assert_allclose(at_rest[:3, 3:], S * inverse_square * t**2 / 2.0, rtol=1e-6)
    np.testing.assert_allclose(at_rest[3:, 3:], S * inverse_square * t, rtol=1e-6)


def test_d11_axes_and_ratios() -> None:
    random = np.random.default_rng(3)
    dJ = random.normal(size=(3, 3))
    dJ = 1e-6 * (dJ + dJ.T)
    moments, R = principal_axes(J)
    after, R_after = principal_axes(J + dJ)
    x, y, z = np.linalg.eigvalsh(J)[::-1]
    M = R.T @ dJ @ R
    found = np.diff(np.log(moments)) * -1.0, np.diff(np.log(after)) * -1.0
    stated = np.array([M[0, 0] / x - M[1, 1] / y, M[1, 1] / y - M[2, 2] / z])
    np.testing.assert_allclose(found[1] - found[0], stated, rtol=1e-4)
    turn = np.array([M[2, 1] / (y - z), -M[0, 2] / (x - z), M[1, 0] / (x - y)])
    np.testing.assert_allclose(log_so3(R.T @ R_after), turn, rtol=1e-4)


@pytest.mark.parametrize("moments", [(0.8, 1.0, 1.3), (1.3, 1.0, 0.8)])
def test_d14_nutation(moments: tuple[float, float, float]) -> None:
    b, c, a = moments
    omega = 0.7
    Omega = omega * np.sqrt((a - b) * (a - c) / (b * c))
    _, w = moved(
        np.diag(moments), np.array([1e-4, 0.0, omega]), np.array([0.0, np.pi / 2 / Omega, np.pi / Omega])
    )
    amplitude_b, amplitude_c = w[0, 0], abs(w[1, 1])
    assert abs(w[1, 0]) < 1e-3 * amplitude_b and w[2, 0] == pytest.approx(-amplitude_b, rel=1e-4)
    assert amplitude_b / amplitude_c == pytest.approx(np.sqrt(c * (a - c) / (b * (a - b))), rel=1e-4)
