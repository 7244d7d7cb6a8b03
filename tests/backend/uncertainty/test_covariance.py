"""The covariance of the last state, along the principal axes and of the body itself."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np

from polhode.backend.dynamics.residuals import FrameStates
from polhode.backend.outliers_and_noise.correlated_noise import measure_correlation, turns_between
from polhode.backend.outliers_and_noise.noise_and_outliers import estimate_noise, whitened_residuals
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.schur import correlated_scores
from polhode.backend.uncertainty.covariance import (
    DependentErrors,
    body_jacobians,
    marginals,
    observation_jacobians,
    state_covariances,
)
from polhode.geometry.lie import Array, hat, inverse_pose, log_so3, transform_points
from polhode.geometry.rigid_fit import mean_rotation
from polhode.records.estimate import MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import BOX, QUIET, at_truth, estimated, nees

NO_OFFSETS = QUIET.model_copy(update={"systematic_px": (0.0, 0.0, 0.0)})


@cache
def solved(w_G: tuple[float, float, float], seed: int = 0) -> tuple[SyntheticSequence, MotionEstimate]:
    scene = SyntheticScene(
        frames=30, landmarks=250, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.2, J_G=BOX, w_G=w_G,
        accel_psd=1e-8, torque_psd=1e-8,
    )  # fmt: skip
    sequence = generate(scene, seed)
    return sequence, estimated(sequence, NO_OFFSETS)


TUMBLE, SPIN = (0.4, 0.5, 0.45), (0.0, 0.0, 0.8)


def along_N(covariance: Array, R: Array, w: Array) -> Array:
    """Covariance (9, 9) of r, v, w along N, from r, v, theta, w in the axes of R."""
    T = np.zeros((9, 12))
    T[:6, :6], T[6:, 6:9], T[6:, 9:] = np.eye(6), -R @ hat(w), R
    return np.asarray(T @ covariance[:12, :12] @ T.T)


def test_both_descriptions_agree_on_what_does_not_depend_on_the_axes() -> None:
    motion = solved(TUMBLE)[1]
    body, joint = motion.covariance_last_body, motion.covariance_last_joint
    assert body is not None
    R_NP, R_NG, w_P = motion.R_NP[-1], motion.X_NG[-1, :3, :3], motion.w_P[-1]
    of_body = along_N(body, R_NG, R_NG.T @ R_NP @ w_P)
    np.testing.assert_allclose(of_body, along_N(joint, R_NP, w_P), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(body[12:, 12:], joint[12:, 12:], rtol=1e-9)
    np.testing.assert_allclose(joint[:6, :12], motion.covariance[-1][:6], rtol=1e-9)
    np.testing.assert_allclose(joint[17:, 17:], motion.mass.cov_com_G, rtol=1e-9)
    # what the first order neglects of the axes is added to the states that are reported, and is small here
    neglected = motion.covariance[-1][6:, 6:] - joint[6:12, 6:12]
    assert np.linalg.eigvalsh(neglected).min() > -1e-12
    assert np.all(np.diag(neglected) < 0.1 * np.diag(joint[6:12, 6:12]))


def test_errors_of_poses_and_of_marks_on_the_body_are_as_large_as_their_covariance_says() -> None:
    of_poses, of_marks = [], []
    for seed in range(3):
        sequence, motion = solved(TUMBLE, seed)
        assert motion.covariance_X_NG is not None and motion.covariance_of_marks is not None
        # G of the estimate in the true one, and what each pose is off beside that
        between = inverse_pose(sequence.X_NG) @ motion.X_NG
        R = mean_rotation(between[:, :3, :3])
        turn = log_so3(R.T @ between[:, :3, :3])
        shift = (between[:, :3, 3] - between[:, :3, 3].mean(axis=0)) @ R
        of_poses.append(nees(np.hstack([shift, turn - turn.mean(axis=0)]), motion.covariance_X_NG))
        assert np.all(np.linalg.eigvalsh(motion.covariance_X_NG) > 0.0)
        # the estimated centre of mass and axes, fixed to the true body as they are in the first frame
        marks, truth = inverse_pose(sequence.X_NG[0]) @ motion.X_NG[0], sequence.truth
        R_NP = sequence.X_NG[:, :3, :3] @ marks[:3, :3] @ motion.mass.R_GP
        arm_N = sequence.X_NG[:, :3, :3] @ transform_points(marks, motion.mass.com_G[None])[0]
        r_N = sequence.X_NG[:, :3, 3] + arm_N
        w_N = np.einsum("fij,fj->fi", truth.R_NP, truth.w_P)
        v_N = truth.v_N + np.cross(w_N, r_N - truth.r_N)
        turn = log_so3(np.swapaxes(R_NP, 1, 2) @ motion.R_NP)
        of_rate = motion.w_P - np.einsum("fji,fj->fi", R_NP, w_N)
        error = np.hstack([motion.r_N - r_N, motion.v_N - v_N, turn, of_rate])
        of_marks.append(nees(error[1:], motion.covariance_of_marks[1:]))
        np.testing.assert_allclose(error[0, :3], 0.0, atol=1e-9)
        np.testing.assert_allclose(motion.covariance_of_marks[0, :3, :3], 0.0, atol=1e-12)
    # neighbouring frames err alike, so the mean of 60 of these scatters as that of some ten
    assert 0.6 < np.mean(of_poses) < 1.6 and 0.6 < np.mean(of_marks) < 1.6


def test_the_covariance_of_the_gradient_is_that_of_dense_algebra() -> None:
    rng = np.random.default_rng(3)
    frame, start = np.array([0, 1, 2, 0, 2, 3, 1, 2, 3]), np.array([0, 3, 6, 9])
    n_frames, stride, n = 4, 7, len(frame)
    to_pose, to_landmark = rng.normal(size=(n, 3, 6)), rng.normal(size=(n, 3, 3))
    variance = rng.uniform(0.5, 3.0, (n, 3))
    half = rng.normal(size=(3, n_frames, n_frames))
    drift = half @ np.swapaxes(half, 1, 2)
    E = np.swapaxes(to_pose, 1, 2) @ to_landmark
    C = np.stack([sum(to_landmark[m].T @ to_landmark[m] for m in range(a, b)) for a, b in pairwise(start)])
    expected, own = np.zeros((stride * n_frames, stride * n_frames)), np.empty((3, 3, 3))
    for mark, (a, b) in enumerate(pairwise(start)):
        J_pose = np.zeros((3 * (b - a), stride * n_frames))
        for m in range(a, b):
            J_pose[3 * (m - a) : 3 * (m - a) + 3, stride * frame[m] : stride * frame[m] + 6] = to_pose[m]
        J = to_landmark[a:b].reshape(-1, 3)
        V = np.zeros((3 * (b - a), 3 * (b - a)))
        for c in range(3):
            V[c::3, c::3] = drift[c][np.ix_(frame[a:b], frame[a:b])] + np.diag(variance[a:b, c])
        inverse = np.linalg.inv(C[mark])
        scores = J_pose - J @ inverse @ J.T @ J_pose
        expected += scores.T @ (V - np.eye(len(V))) @ scores
        own[mark] = inverse @ J.T @ V @ J @ inverse
    excess, C_inv = np.zeros_like(expected), np.linalg.inv(C)
    found = correlated_scores(excess, frame, start, variance, drift, to_pose, to_landmark, E, C_inv, stride)
    np.testing.assert_allclose(np.tril(excess), np.tril(expected), atol=1e-9)
    np.testing.assert_allclose(found, own, atol=1e-9)


def with_drift(seed: int, drift_px: float) -> tuple[SyntheticSequence, MotionFit]:
    """A tumble whose landmarks slide as it turns, and the motion fitted to it."""
    scene = SyntheticScene(
        frames=40, landmarks=150, detection=0.95, sigma_uv_px=0.2, sigma_d_px=0.2, J_G=BOX,
        w_G=(0.08, 0.1, 0.09), accel_psd=1e-11, torque_psd=1e-11,
    )  # fmt: skip
    sequence = generate(scene, seed)
    truth = at_truth(sequence)
    data, rng, uvd = truth.data, np.random.default_rng(seed), truth.data.uvd_px.copy()
    turn_rad = turns_between(truth.iterate.R_NG, data.R_RN @ truth.iterate.R_NG)
    for a, b in pairwise(data.start):
        alike = np.exp(-turn_rad[np.ix_(data.frame[a:b], data.frame[a:b])] / 2.0)
        slide = np.linalg.cholesky(alike + 1e-9 * np.eye(b - a)) @ rng.normal(size=(b - a, 2))
        uvd[a:b, :2] += drift_px * slide
    fit = truth.with_data(uvd_px=uvd, accel_psd=1e-11, torque_psd=1e-11)
    fit = fit.moved_to(GaussNewton(fit.data).solve(fit.linearized(), fit.iterate.vector(), 30).x)
    return sequence, replace(fit, data=fit.data.rescaled(estimate_noise(fit, robust=False)))


def test_the_errors_of_sliding_landmarks_are_as_large_as_the_covariance_says() -> None:
    found_nees: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(5):
        sequence, fit = with_drift(seed, drift_px=0.5)
        data, iterate = fit.data, fit.iterate
        turn_rad = turns_between(iterate.R_NG, data.R_RN @ iterate.R_NG)
        found = measure_correlation(data, whitened_residuals(fit), observation_jacobians(fit)[1], turn_rad)
        assert found is not None
        common = np.zeros((len(data.frame), 3, 0))
        dependent = DependentErrors(found.variance(data), found.drift_between(turn_rad), common)
        r_N = FrameStates.of(iterate, data.camera_N).centres()
        errors = np.hstack([sequence.truth.r_N - r_N, sequence.truth.v_N - iterate.v_N])
        for known in (True, False):
            m = marginals(fit, np.ones(len(data.frame)), dependent if known else None)
            covariance = state_covariances(iterate, m, body_jacobians(iterate, data.camera_N))[0]
            found_nees[known].append(nees(errors, covariance[:, :6, :6]))
    assert 0.6 < np.mean(found_nees[True]) < 1.5
    assert np.mean(found_nees[False]) > 1.4 * np.mean(found_nees[True])
