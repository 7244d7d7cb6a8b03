"""The filter of a body known from a run: its derivatives, its motion, and its consistency."""

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from benchmarks.navigation.body_filter import (
    BIAS,
    COM,
    OUTWARD,
    SIZE,
    THETA,
    XI,
    BodyState,
    MeasuredPose,
    R,
    V,
    W,
    arrival_covariance,
    first_state,
    measured_jacobian,
    pose_jacobian,
    predict,
    turned,
    update,
)
from polhode.lie import Array, exp_so3, inverse_pose, log_so3, make_pose
from polhode.planning.edges.observability_metric import moved, pose_error
from polhode.planning.prediction import FinalEstimate, FinalState
from polhode.rigid_body import propagate

MOMENTS = np.diag([1.3, 1.0, 0.8])
J_JACOBIAN = np.array(
    [
        np.diag([1.0, 0.0, 0.0]),
        np.diag([0.0, 0.0, 1.0]),
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
    ]
)
SIGMA = np.repeat([2e-3, 3e-4, 3e-3, 3e-4, 5e-3, 2e-3], [3, 3, 3, 3, 5, 3])
LAST = FinalState(
    np.array([0.1, 0.05, 2.4]),
    np.array([1e-3, -2e-3, 5e-4]),
    exp_so3([0.4, -0.2, 0.9]),
    np.array([0.05, 0.12, 0.04]),
    MOMENTS,
    np.eye(3),
    J_JACOBIAN,
    np.diag(SIGMA**2),
)
ESTIMATE = FinalEstimate(LAST, np.array([0.05, -0.02, 0.1]), 1e-9, 1e-9)
QUIET = replace(ESTIMATE, accel_psd=0.0, torque_psd=0.0)
BIAS_COVARIANCE = np.diag(np.repeat([3e-3, 6e-3], 3) ** 2)
OUTWARD_M = 3e-3
O_G = np.array([0.1, 0.0, -0.05])
CAMERA = make_pose(exp_so3([0.1, -0.05, 0.2]), [0.05, 0.1, -0.1])


def first() -> BodyState:
    return first_state(ESTIMATE, BIAS_COVARIANCE, OUTWARD_M)


def difference(after: BodyState, before: BodyState) -> Array:
    """(27,) of two states."""
    out = np.zeros(SIZE)
    out[R], out[V] = after.r_N - before.r_N, after.v_N - before.v_N
    out[THETA], out[W] = log_so3(before.R_NG.T @ after.R_NG), after.w_G - before.w_G
    out[XI], out[COM] = after.xi - before.xi, after.com_G - before.com_G
    out[BIAS], out[OUTWARD] = after.bias - before.bias, after.outward - before.outward
    return out


def test_the_body_turns_as_a_free_rigid_body() -> None:
    state = first()
    R_NG, w_G = turned(state.R_NG[None], state.w_G[None], state.J_G[None], 12.0)
    _, _, R_true, w_true = propagate(
        np.array([0.0, 12.0]), state.r_N, state.v_N, state.R_NG, state.w_G, state.J_G
    )
    assert np.abs(w_G[0] - w_true[-1]).max() < 1e-8
    assert np.linalg.norm(log_so3(R_true[-1].T @ R_NG[0])) < 1e-6


def test_covariance_of_the_motion_is_that_of_finite_differences() -> None:
    state, kept = first(), 0.6
    end = predict(state, QUIET, 8.0, BIAS_COVARIANCE, kept)
    F = np.zeros((SIZE, SIZE))
    for column, nudge in enumerate(1e-4 * np.eye(SIZE)):
        ends = [predict(state.plus(sign * nudge), QUIET, 8.0, BIAS_COVARIANCE, kept) for sign in (1.0, -1.0)]
        F[:, column] = (difference(ends[0], end) - difference(ends[1], end)) / 2e-4
    expected = F @ state.covariance @ F.T
    expected[BIAS, BIAS] += (1.0 - kept**2) * BIAS_COVARIANCE
    scale = np.sqrt(np.diagonal(end.covariance))
    assert np.abs((expected - end.covariance) / np.outer(scale, scale)).max() < 1e-5
    # the inertia matters for the attitude, or nothing was tested
    assert np.abs(F[THETA, XI]).max() > 0.1


def test_derivative_of_the_measured_pose() -> None:
    state = first()
    X_RN, expected = inverse_pose(CAMERA), np.zeros((6, SIZE))
    for column, nudge in enumerate(1e-5 * np.eye(SIZE)):
        after, before = (X_RN @ state.plus(sign * nudge).X_NG for sign in (1.0, -1.0))
        expected[:, column] = pose_error(after, before, O_G) / 2e-5
    assert np.abs(pose_jacobian(state, CAMERA, O_G) - expected).max() < 1e-6
    H = np.zeros((12, SIZE))
    H[:6], H[6:9, V], H[9:, W] = expected, np.eye(3), np.eye(3)
    own = arrival_covariance(state, CAMERA, O_G)
    assert np.abs(own - H @ state.covariance @ H.T).max() < 1e-6 * own.max()


def test_errors_are_as_large_as_the_covariance_says() -> None:
    rng = np.random.default_rng(4)
    runs, steps, noise = 30, 3, np.diag(np.repeat([2e-3, 3e-3], 3) ** 2)
    outward = np.array([0.2, -0.1, 2.5, 0.1, 0.0, 0.2])
    nees, nis = [], []
    for _ in range(runs):
        state = first()
        true = state.plus(np.linalg.cholesky(state.covariance) @ rng.normal(size=SIZE))
        for _ in range(steps):
            step = predict(true, QUIET, 4.0, BIAS_COVARIANCE, 0.5)
            fresh = np.sqrt(1.0 - 0.5**2) * np.linalg.cholesky(BIAS_COVARIANCE) @ rng.normal(size=6)
            true = replace(step, bias=step.bias + fresh)
            state = predict(state, QUIET, 4.0, BIAS_COVARIANCE, 0.5)
            error = true.bias + outward * true.outward + np.linalg.cholesky(noise) @ rng.normal(size=6)
            X_RG = moved(inverse_pose(CAMERA) @ true.X_NG, error, O_G)
            after = update(state, CAMERA, MeasuredPose(X_RG, noise, outward, np.zeros(6)), O_G)
            state = after.state
            nis.append(after.nis)
        error = difference(state, true)
        nees.append(error @ np.linalg.solve(state.covariance, error))
    for total, freedom in ((sum(nees), runs * SIZE), (sum(nis), runs * steps * 6)):
        assert chi2.ppf(0.0005, freedom) < total < chi2.ppf(0.9995, freedom)
    # poses improve what they measure, and tell of the mesh's size
    blind = first()
    for _ in range(steps):
        blind = predict(blind, QUIET, 4.0, BIAS_COVARIANCE, 0.5)
    before, after_all = blind.covariance, state.covariance
    assert np.trace(after_all[THETA, THETA]) < 0.6 * np.trace(before[THETA, THETA])
    assert after_all[OUTWARD, OUTWARD] < 0.8 * before[OUTWARD, OUTWARD]


def test_a_pose_beyond_the_gate_changes_nothing() -> None:
    state = first()
    far = moved(inverse_pose(CAMERA) @ state.X_NG, np.array([0.0, 0.0, 0.1, 0.0, 0.2, 0.0]), O_G)
    measured = MeasuredPose(far, 1e-6 * np.eye(6), np.zeros(6), np.zeros(6))
    refused = update(state, CAMERA, measured, O_G, gate=0.999)
    assert not refused.taken and refused.state is state
    assert update(state, CAMERA, measured, O_G).taken


def test_a_pose_that_the_prediction_has_drawn_towards_it_tells_the_same() -> None:
    state, outward = first(), np.zeros(6)
    noise = np.diag([1e-3, 1e-3, 8e-3, 2e-3, 2e-3, 5e-2]) ** 2
    H = measured_jacobian(state, CAMERA, O_G, outward)
    information = np.linalg.inv(H @ state.covariance @ H.T)
    predicted = inverse_pose(CAMERA) @ state.X_NG
    edges_alone = np.array([1e-3, -2e-3, 5e-3, 1e-3, 2e-3, 3e-2])
    # where the pull of both is the same: least squares of the edges and of the prediction
    both = np.linalg.solve(np.linalg.inv(noise) + information, np.linalg.solve(noise, edges_alone))
    drawn = moved(predicted, both, O_G)
    beyond = noise @ information @ pose_error(drawn, predicted, O_G)
    assert np.abs(both + beyond - edges_alone).max() < 1e-6
    poses = (moved(predicted, edges_alone, O_G), np.zeros(6)), (drawn, beyond)
    one, other = (update(state, CAMERA, MeasuredPose(X, noise, outward, off), O_G) for X, off in poses)
    assert np.isclose(one.nis, other.nis, rtol=1e-3)
    assert np.abs(difference(one.state, other.state)).max() < 1e-5
    assert np.allclose(one.state.covariance, other.state.covariance)
