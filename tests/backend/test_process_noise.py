"""The process noise against closed forms, against a Monte Carlo, and for its conditioning."""

import numpy as np

from backend.process_noise import (
    rotation_covariance,
    rotation_covariance_scaled,
    translation_covariance,
    whitening,
)
from polhode.lie import log_so3
from polhode.rigid_body import propagate


def test_double_integrator_has_its_closed_form() -> None:
    t = 0.7
    expected = 2e-6 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
    np.testing.assert_allclose(translation_covariance(np.array([t]), 2e-6)[0], expected)


def test_rotation_without_rate_is_a_double_integrator_too() -> None:
    t = 0.7
    cov = rotation_covariance(np.zeros((1, 3)), np.eye(3), np.array([t]), 2e-6)[0]
    block = 2e-6 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
    np.testing.assert_allclose(cov, np.kron(block, np.eye(3)), rtol=1e-9, atol=1e-18)


def test_torque_noise_is_divided_by_the_moments_over_the_middle_one() -> None:
    cov = rotation_covariance(np.zeros((1, 3)), np.diag([4.0, 2.0, 3.0]), np.array([0.1]), 1e-6)[0]
    np.testing.assert_allclose(np.diag(cov)[3:], 1e-7 * np.array([3 / 4, 3 / 2, 1.0]) ** 2, rtol=1e-9)


def test_covariance_agrees_with_impulses_propagated_through_the_full_dynamics() -> None:
    # the integral of eq. 4.55 by quadrature, its transition by differences of an independent integrator
    J, w0, t, q = np.diag([1.4, 1.0, 0.8]), np.array([0.6, 1.0, 0.3]), 1.0, 1e-6
    nodes, weights = np.polynomial.legendre.leggauss(8)
    total, size = np.zeros((6, 6)), 1e-6
    for node, weight in zip(0.5 * t * (nodes + 1.0), 0.5 * t * weights, strict=True):
        _, _, R, w = propagate([0.0, node, t], np.zeros(3), np.zeros(3), np.eye(3), w0, J)
        columns = []
        for axis in np.eye(3):
            kick = np.linalg.inv(J) @ axis * size
            _, _, R_kicked, w_kicked = propagate([node, t], np.zeros(3), np.zeros(3), R[1], w[1] + kick, J)
            columns.append(np.concatenate([log_so3(R[2].T @ R_kicked[1]), w_kicked[1] - w[2]]) / size)
        G = np.stack(columns, axis=1)
        total += weight * q * G @ G.T
    cov = rotation_covariance(w0[None], J, np.array([t]), q)[0]
    np.testing.assert_allclose(cov, total, rtol=1e-4, atol=1e-4 * np.abs(total).max())


def test_scaled_covariance_is_well_conditioned_from_a_millisecond_to_ten_seconds() -> None:
    dt = np.array([1e-3, 1e-2, 0.1, 1.0, 10.0])
    cov, _ = rotation_covariance_scaled(np.tile([0.0, 0.1, 0.0], (5, 1)), np.eye(3), dt, 1e-6)
    assert np.linalg.cond(cov).max() < 100.0
    plain = rotation_covariance(np.zeros((1, 3)), np.eye(3), dt[:1], 1e-6)
    assert np.linalg.cond(plain[0]) > 1e6


def test_whitening_is_the_square_root_of_the_information() -> None:
    w, J, dt = np.array([[0.3, 0.8, -0.2]]), np.diag([1.3, 1.0, 0.9]), np.array([0.5])
    W_t, W_r, _ = whitening(w, J, dt, 1e-6, 3e-6)
    np.testing.assert_allclose(
        W_r[0] @ rotation_covariance(w, J, dt, 3e-6)[0] @ W_r[0].T, np.eye(6), atol=1e-9
    )
    np.testing.assert_allclose(W_t[0] @ translation_covariance(dt, 1e-6)[0] @ W_t[0].T, np.eye(2), atol=1e-9)
