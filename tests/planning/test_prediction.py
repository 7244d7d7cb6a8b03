"""Predictions against the integrated truth and against Monte Carlo."""

import numpy as np
import pytest

from planning.prediction import LastState, predict
from polhode.lie import exp_so3, log_so3
from polhode.rigid_body import propagate

MOMENTS = np.array([1.3, 1.0, 0.8])
R0 = exp_so3([0.4, -0.2, 0.9])
W0 = np.array([0.15, 0.5, 0.1])


def last_state(covariance: np.ndarray, by_parameters: np.ndarray | None = None) -> LastState:
    by = np.zeros((3, 0)) if by_parameters is None else by_parameters
    return LastState(np.array([0.1, 0.0, 0.6]), np.array([1e-3, 2e-3, 0.0]), R0, W0, MOMENTS, covariance, by)


def test_the_mean_follows_the_rigid_body() -> None:
    t = np.array([0.0, 5.0, 20.0])
    found = predict(last_state(np.zeros((12, 12))), t, 0.0, 0.0)
    r, v, R, w = propagate(t, [0.1, 0.0, 0.6], [1e-3, 2e-3, 0.0], R0, W0, np.diag(MOMENTS))
    np.testing.assert_allclose(found.R_NP, R, atol=1e-9)
    np.testing.assert_allclose(found.r_N, r, atol=1e-12)
    np.testing.assert_allclose(found.w_P, w, atol=1e-9)
    np.testing.assert_allclose(found.v_N, v, atol=1e-12)
    np.testing.assert_allclose(found.covariance, 0.0, atol=1e-20)


def test_at_time_zero_the_covariance_is_that_of_the_state() -> None:
    A = np.random.default_rng(0).normal(size=(12, 12)) * 1e-3
    found = predict(last_state(A @ A.T), [0.0], 1e-6, 1e-6)
    np.testing.assert_allclose(found.covariance[0], A @ A.T, atol=1e-15)


def test_covariance_matches_monte_carlo_with_uncertain_moments() -> None:
    rng = np.random.default_rng(2)
    scale = np.concatenate([np.repeat([1e-3, 1e-4, 2e-4, 1e-4], 3), np.full(5, 2e-4)])
    A = (np.eye(17) + 0.3 * rng.normal(size=(17, 17))) * scale[:, None]
    by_parameters = np.zeros((3, 5))
    by_parameters[0, :2], by_parameters[2, 2:4] = (1.0, 0.5), (-0.7, 0.4)
    last = last_state(A @ A.T, by_parameters)
    predicted = predict(last, [12.0], 0.0, 0.0)
    errors = []
    for e in rng.normal(size=(400, 17)) @ A.T:
        J = np.diag(MOMENTS + by_parameters @ e[12:])
        r, v, R, w = propagate(
            [0.0, 12.0], last.r_N + e[:3], last.v_N + e[3:6], R0 @ exp_so3(e[6:9]), W0 + e[9:12], J, rtol=1e-9
        )
        theta = log_so3(predicted.R_NP[0].T @ R[1])
        errors.append(
            np.concatenate([r[1] - predicted.r_N[0], v[1] - predicted.v_N[0], theta, w[1] - predicted.w_P[0]])
        )
    sampled = np.cov(np.array(errors).T)
    whiten = np.linalg.inv(np.linalg.cholesky(predicted.covariance[0]))
    # Of 400 samples, eigenvalues of the whitened 12 x 12 sample covariance lie within about 1 +- 0.35.
    values = np.linalg.eigvalsh(whiten @ sampled @ whiten.T)
    assert values.min() > 0.6
    assert values.max() < 1.5


def test_process_noise_matches_monte_carlo() -> None:
    rng = np.random.default_rng(5)
    psd, dt, steps = 1e-6, 0.1, 60
    last = last_state(np.zeros((12, 12)))
    predicted = predict(last, [dt * steps], psd, psd)
    n = 3000
    w = np.tile(W0, (n, 1))
    theta_R = np.tile(R0, (n, 1, 1))
    v = np.zeros((n, 3))
    for _ in range(steps):
        # Midpoint rule for the body, kicks of white torque and acceleration between the steps.
        w = w + rng.normal(size=(n, 3)) * np.sqrt(psd * dt) / MOMENTS
        v = v + rng.normal(size=(n, 3)) * np.sqrt(psd * dt)
        middle = w + 0.5 * dt * np.cross(w * MOMENTS, w) / MOMENTS
        w = w + dt * np.cross(middle * MOMENTS, middle) / MOMENTS
        theta_R = theta_R @ exp_so3(middle * dt)
    errors = np.hstack([log_so3(predicted.R_NP[0].T @ theta_R), w - predicted.w_P[0]])
    spread = np.sqrt(np.diagonal(predicted.covariance[0]))
    np.testing.assert_allclose(errors.std(axis=0), spread[6:], rtol=0.1)
    np.testing.assert_allclose(v.std(axis=0), spread[3:6], rtol=0.1)
    assert spread[0] == pytest.approx(np.sqrt(psd * (dt * steps) ** 3 / 3))


def test_what_is_undetermined_makes_undetermined_only_what_depends_on_it() -> None:
    covariance = np.diag(np.full(12, 1e-6))
    covariance[6, 6] = np.inf
    found = predict(last_state(covariance), [3.0], 0.0, 0.0)
    assert np.isfinite(np.diagonal(found.covariance[0])[:6]).all()
    assert np.isfinite(np.diagonal(found.covariance[0])[9:]).all()
    assert np.isinf(np.diagonal(found.covariance[0])[6:9]).any()
