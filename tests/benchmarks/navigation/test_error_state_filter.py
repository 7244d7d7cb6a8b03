"""The navigation filter against finite differences, a batch solution, statistics; unobservable directions."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from benchmarks.navigation.error_state_filter import (
    State,
    Target,
    measurement_jacobian,
    observable_directions,
    predict,
    predicted_pose,
    propagate_rotation,
    update,
)
from benchmarks.navigation.found_poses import TrackedPose
from benchmarks.navigation.recorded_flights import (
    Calibrated,
    Fixed,
    Gated,
    ResidualChecked,
)
from polhode.lie import Array, exp_so3, make_pose
from polhode.planning.edges.observability_metric import moved, pose_error
from polhode.planning.prediction import process_noise
from polhode.rigid_body import propagate

TARGET = Target(
    np.array([1.3, 1.0, 0.8]),
    make_pose(exp_so3([-0.3, 0.5, 0.2]), [0.05, -0.1, 0.2]),
    np.array([0.1, 0.02, -0.05]),
    0.5,
    1e-7,
    1e-7,
)
QUIET = replace(TARGET, accel_psd=0.0, torque_psd=0.0)
P0 = np.diag(np.repeat([0.05, 0.01, 0.05, 0.01], 3) ** 2)
R_NR = exp_so3([0.2, -0.4, 0.1])
STATE = State(
    R_NR @ np.array([0.1, 0.05, 3.0]),
    np.array([1e-2, 2e-2, -1e-2]),
    exp_so3([0.4, -0.2, 0.9]),
    np.array([0.05, 0.2, 0.1]),
    P0,
)
NO_PUSH = np.zeros(3)
SIGMA = np.array([2e-3, 3e-3, 1e-2, 1e-2, 2e-2, 5e-3])


def difference(f: Callable[[Array], Array], step: float) -> Array:
    """Central differences of a function of twelve errors, fourth order."""
    columns = []
    for e in np.eye(12) * step:
        columns.append((8.0 * (f(e) - f(-e)) - (f(2 * e) - f(-2 * e))) / (12.0 * step))
    return np.stack(columns, axis=1)


def information(rng: np.random.Generator) -> Array:
    """Of errors of about SIGMA, correlated."""
    A = SIGMA[:, None] * (np.eye(6) + 0.4 * rng.normal(size=(6, 6)))
    return np.asarray(np.linalg.inv(A @ A.T))


def measured(true: State, target: Target, rng: np.random.Generator, info: Array) -> Array:
    """A pose with an error of that information."""
    step = np.linalg.cholesky(np.linalg.inv(info)) @ rng.normal(size=6)
    return moved(predicted_pose(true, target, R_NR), step, target.o_G)


def pushed(state: State, target: Target, dt_s: float, rng: np.random.Generator) -> State:
    """The truth one step on, with disturbances as the filter takes them to be."""
    noise = process_noise(target.moments, state.w_P, np.array([dt_s]), target.accel_psd, target.torque_psd)[0]
    return predict(state, target, dt_s, NO_PUSH).plus(np.linalg.cholesky(noise) @ rng.normal(size=12))


def test_derivative_of_the_measurement() -> None:
    here = predicted_pose(STATE, TARGET, R_NR)

    def pose(error: Array) -> Array:
        return pose_error(predicted_pose(STATE.plus(error), TARGET, R_NR), here, TARGET.o_G)

    H = measurement_jacobian(STATE, TARGET, R_NR)
    assert np.abs(H - difference(pose, 1e-3)).max() < 1e-6
    assert np.abs(H).max() > 0.1


def test_derivative_of_the_motion() -> None:
    push = np.array([0.01, 0.0, 0.02])
    end = predict(STATE, QUIET, 2.0, push)

    def later(error: Array) -> Array:
        return end.error(predict(STATE.plus(error), QUIET, 2.0, push))

    F = -difference(later, 1e-3)
    assert np.abs(F[6:, 6:] - propagate_rotation(TARGET.moments, STATE.w_P, 2.0, 0.0)[2]).max() < 1e-6
    assert np.abs(F @ P0 @ F.T - end.covariance).max() < 1e-6
    assert np.abs(F[6:, :6]).max() < 1e-9 and np.abs(F[6:9, 9:]).max() > 1.5


def test_the_motion_is_that_of_a_free_body_seen_from_a_pushed_inspector() -> None:
    push, t = np.array([0.03, -0.01, 0.02]), np.array([0.0, 1.5])
    end = predict(STATE, QUIET, t[1], push)
    inspector = propagate(
        t, np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3), np.eye(3), lambda _: (push, NO_PUSH)
    )
    target = propagate(t, STATE.r_N, STATE.v_N, STATE.R_NP, STATE.w_P, np.diag(TARGET.moments))
    assert np.allclose(end.r_N, target[0][1] - inspector[0][1], atol=1e-12)
    assert np.allclose(end.v_N, target[1][1] - inspector[1][1], atol=1e-12)
    assert np.allclose(end.R_NP, target[2][1], atol=1e-9) and np.allclose(end.w_P, target[3][1], atol=1e-9)


def test_disturbances_add_what_the_predictions_say() -> None:
    added = predict(STATE, TARGET, 2.0, NO_PUSH).covariance - predict(STATE, QUIET, 2.0, NO_PUSH).covariance
    expected = process_noise(TARGET.moments, STATE.w_P, np.array([2.0]), TARGET.accel_psd, TARGET.torque_psd)
    assert np.abs(added - expected[0]).max() < 1e-6 * np.abs(expected).max()


def test_errors_are_what_plus_adds() -> None:
    error = np.random.default_rng(0).normal(size=12) * 0.1
    assert np.allclose(STATE.plus(error).error(STATE), error, atol=1e-12)


def test_without_disturbances_it_ends_where_a_batch_solution_does() -> None:
    """To first order: errors a hundred times smaller leave a difference that vanishes with their square."""

    def both(size: float) -> tuple[Array, Array]:
        rng = np.random.default_rng(4)
        begin = replace(STATE, covariance=P0 * size**2)
        truth = begin.plus(np.linalg.cholesky(P0) @ rng.normal(size=12) * size)
        info = [information(rng) / size**2 for _ in range(3)]
        poses = []
        for each in info:
            truth = predict(truth, QUIET, 4.0, NO_PUSH)
            poses.append(measured(truth, QUIET, rng, each))

        def residuals(error: Array) -> Array:
            state, out = begin.plus(error * size), [np.linalg.solve(np.linalg.cholesky(P0), error)]
            for pose, each in zip(poses, info, strict=True):
                state = predict(state, QUIET, 4.0, NO_PUSH)
                off = pose_error(pose, predicted_pose(state, QUIET, R_NR), QUIET.o_G)
                out.append(np.linalg.cholesky(each).T @ off)
            return np.concatenate(out)

        solution = least_squares(residuals, np.zeros(12), x_scale=np.sqrt(np.diag(P0)), xtol=1e-9, ftol=1e-9)
        batch = begin.plus(solution.x * size)
        state = begin
        for pose, each in zip(poses, info, strict=True):
            batch = predict(batch, QUIET, 4.0, NO_PUSH)
            state = update(predict(state, QUIET, 4.0, NO_PUSH), QUIET, R_NR, pose, each).state
        sigma = np.sqrt(np.diag(state.covariance))
        return batch.error(state) / sigma, truth.error(state) / sigma

    apart, off = both(0.01)
    assert np.abs(apart).max() < 1e-2
    assert np.abs(off).max() > 0.3
    assert np.abs(apart).max() < 0.05 * np.abs(both(1.0)[0]).max()


def test_its_covariance_and_innovations_are_what_they_claim() -> None:
    rng, runs, steps = np.random.default_rng(2), 25, 6
    nees, nis = [], []
    for _ in range(runs):
        truth, state = STATE.plus(np.linalg.cholesky(P0) @ rng.normal(size=12)), STATE
        for _ in range(steps):
            truth = pushed(truth, TARGET, 1.0, rng)
            state = predict(state, TARGET, 1.0, NO_PUSH)
            info = information(rng)
            after = update(state, TARGET, R_NR, measured(truth, TARGET, rng, info), info)
            state = after.state
            nis.append(after.nis)
        nees.append(state.nees(truth))
    low, high = chi2.ppf([0.005, 0.995], 12 * runs) / runs
    assert low < np.mean(nees) < high
    low, high = chi2.ppf([0.005, 0.995], 6 * runs * steps) / (runs * steps)
    assert low < np.mean(nis) < high


def test_the_update_is_that_of_kalman_where_all_is_told() -> None:
    rng = np.random.default_rng(5)
    info = information(rng)
    X = measured(STATE, TARGET, rng, info)
    after = update(STATE, TARGET, R_NR, X, info)
    H = measurement_jacobian(STATE, TARGET, R_NR)
    expected = np.linalg.inv(np.linalg.inv(P0) + H.T @ info @ H)
    off = pose_error(X, predicted_pose(STATE, TARGET, R_NR), TARGET.o_G)
    assert np.allclose(STATE.error(after.state), -expected @ H.T @ info @ off, atol=1e-9)
    # the reset turns the covariance by half of the attitude's change
    assert np.allclose(after.state.covariance, expected, atol=2e-2 * np.abs(expected).max())
    assert after.directions == 6 and after.taken


def test_what_is_not_told_stays_as_it_was() -> None:
    rng = np.random.default_rng(6)
    D = rng.normal(size=(4, 6))
    info = D.T @ D * 1e4
    unseen = np.linalg.svd(D)[2][4:].T
    X = moved(predicted_pose(STATE, TARGET, R_NR), unseen @ np.array([0.02, 0.01]), TARGET.o_G)
    after = update(STATE, TARGET, R_NR, X, info)
    assert after.directions == 4
    assert np.abs(STATE.error(after.state)).max() < 2e-3
    H = measurement_jacobian(STATE, TARGET, R_NR)
    assert np.allclose(np.linalg.inv(np.linalg.inv(P0) + H.T @ info @ H), after.state.covariance, atol=1e-5)
    nothing = update(STATE, TARGET, R_NR, X, np.zeros((6, 6)))
    assert nothing.directions == 0 and not nothing.taken and nothing.state is STATE


def test_told_directions_hold_the_information() -> None:
    info = information(np.random.default_rng(7))
    D, variance = observable_directions(info, 0.5)
    assert np.allclose(D.T / variance @ D, info, rtol=1e-9, atol=1e-6)


def test_the_gate_refuses_what_is_far_off() -> None:
    info = np.diag(1.0 / SIGMA**2)
    X = moved(predicted_pose(STATE, TARGET, R_NR), np.array([0.0, 0.0, 0.8, 0.0, 0.0, 0.0]), TARGET.o_G)
    refused = update(STATE, TARGET, R_NR, X, info, gate=0.999)
    assert not refused.taken and refused.state is STATE and refused.nis > 22.4
    assert update(STATE, TARGET, R_NR, X, info).taken


def test_weightings() -> None:
    info, constant = np.diag(1.0 / SIGMA**2), np.eye(6)
    good = TrackedPose(np.eye(4), info, 0.8, 1.1)
    few, wrong = replace(good, found_share=0.3), replace(good, residual=3.0)
    assert Fixed(constant)(few) is constant
    assert Gated(constant, 0.5)(few) is None and Gated(constant, 0.5)(good) is constant
    weighted = Calibrated(4.0)(few)
    assert weighted is not None and np.allclose(weighted, info / 4.0)
    assert Calibrated()(replace(good, information=np.zeros((6, 6)))) is None
    checked = ResidualChecked(Fixed(constant), 2.0)
    assert checked(wrong) is None and checked(good) is constant


@pytest.mark.parametrize("turn", [1e-9, 0.5])
def test_disturbances_grow_the_covariance(turn: float) -> None:
    state = replace(STATE, w_P=turn * STATE.w_P)
    more = predict(state, TARGET, 1.0, NO_PUSH).covariance - predict(state, QUIET, 1.0, NO_PUSH).covariance
    assert np.linalg.eigvalsh(more).min() > -1e-15 and np.trace(more) > 0.0
