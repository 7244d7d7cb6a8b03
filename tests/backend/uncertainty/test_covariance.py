"""The covariance of the last state, along the principal axes and of the body itself."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.dynamics.residuals import FrameStates
from polhode.backend.outliers_and_noise.correlated_noise import (
    measure_correlation,
    turns_between,
)
from polhode.backend.outliers_and_noise.outliers import estimate_noise
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import linearization_point
from polhode.backend.solvers.schur import correlated_scores
from polhode.backend.uncertainty.covariance import (
    DependentErrors,
    body_jacobians,
    marginals,
    observation_jacobians,
    state_covariances,
)
from polhode.config.backend_settings import Backend
from polhode.lie import Array, hat, inverse_pose, log_so3, transform_points
from polhode.progress import Silent
from polhode.records import MotionEstimate
from polhode.rigid_fit import mean_rotation
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.outliers_and_noise.test_outliers import at_truth

BOX = np.diag([1.5, 1.2, 0.9])


def estimate(w_G: tuple[float, float, float]) -> MotionEstimate:
    scene = SyntheticScene(
        frames=30, landmarks=250, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.2, J_G=BOX, w_G=w_G,
        accel_psd=1e-8, torque_psd=1e-8,
    )  # fmt: skip
    sequence = generate(scene, 0)
    config = Backend(solver="gauss_newton", process_noise="given", accel_psd=1e-8, torque_psd=1e-8)
    return estimate_motion(
        sequence.tracks, initialize_motion(sequence.tracks, sequence.relative, config), config, Silent()
    )


def along_N(covariance: Array, R: Array, w: Array) -> Array:
    """Covariance (9, 9) of r, v, w along N, from r, v, theta, w in the axes of R."""
    T = np.zeros((9, 12))
    T[:6, :6], T[6:, 6:9], T[6:, 9:] = np.eye(6), -R @ hat(w), R
    return np.asarray(T @ covariance[:12, :12] @ T.T)


def test_both_descriptions_agree_on_what_does_not_depend_on_the_axes() -> None:
    motion = estimate((0.4, 0.5, 0.45))
    assert motion.covariance_last_body is not None
    R_NP, R_NG = motion.R_NP[-1], motion.X_NG[-1, :3, :3]
    w_P = motion.w_P[-1]
    of_axes = along_N(motion.covariance_last_joint, R_NP, w_P)
    of_body = along_N(motion.covariance_last_body, R_NG, R_NG.T @ R_NP @ w_P)
    np.testing.assert_allclose(of_body, of_axes, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(
        motion.covariance_last_body[12:, 12:], motion.covariance_last_joint[12:, 12:], rtol=1e-9
    )


def test_the_body_s_own_covariance_is_finite_where_the_axes_are_undetermined() -> None:
    motion = estimate((0.0, 0.0, 0.8))
    assert np.isinf(motion.covariance_last_joint[6:12, 6:12]).any()
    assert motion.covariance_last_body is not None
    sigma = np.sqrt(np.diag(motion.covariance_last_body))
    # attitude and rate of what the camera sees are well known, whatever the axes
    assert np.all(sigma[6:9] < np.deg2rad(1.0)) and np.all(sigma[9:12] < np.deg2rad(1.0))
    assert np.all(np.linalg.eigvalsh(motion.covariance_last_body) > -1e-12)


def test_the_covariance_of_each_pose_without_what_all_share_holds_its_errors() -> None:
    squares = []
    for seed in range(3):
        scene = SyntheticScene(
            frames=20, landmarks=250, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.2, J_G=BOX,
            w_G=(0.4, 0.5, 0.45), accel_psd=1e-8, torque_psd=1e-8,
        )  # fmt: skip
        sequence = generate(scene, seed)
        config = Backend(solver="gauss_newton", process_noise="given", accel_psd=1e-8, torque_psd=1e-8)
        first = initialize_motion(sequence.tracks, sequence.relative, config)
        motion = estimate_motion(sequence.tracks, first, config, Silent())
        assert motion.covariance_X_NG is not None
        # G of the estimate in the true one, and what each pose is off beside that
        between = inverse_pose(sequence.X_NG) @ motion.X_NG
        R = mean_rotation(between[:, :3, :3])
        turn = np.stack([log_so3(R.T @ each) for each in between[:, :3, :3]])
        shift = (between[:, :3, 3] - between[:, :3, 3].mean(axis=0)) @ R
        error = np.concatenate([shift, turn - turn.mean(axis=0)], axis=1)
        squares.append(np.einsum("fi,fij,fj->f", error, np.linalg.inv(motion.covariance_X_NG), error) / 6.0)
        assert np.all(np.linalg.eigvalsh(motion.covariance_X_NG) > 0.0)
    # neighbouring frames err alike, so the mean of 60 of these scatters as that of some ten
    assert 0.6 < np.mean(squares) < 1.6


def test_the_body_is_where_the_covariance_of_its_marks_says_in_every_frame() -> None:
    squares = []
    for seed in range(3):
        scene = SyntheticScene(
            frames=20, landmarks=250, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.2, J_G=BOX,
            w_G=(0.4, 0.5, 0.45), accel_psd=1e-8, torque_psd=1e-8,
        )  # fmt: skip
        sequence = generate(scene, seed)
        config = Backend(
            solver="gauss_newton", process_noise="given", accel_psd=1e-8, torque_psd=1e-8,
            systematic_px=(0.0, 0.0, 0.0),
        )  # fmt: skip
        first = initialize_motion(sequence.tracks, sequence.relative, config)
        motion = estimate_motion(sequence.tracks, first, config, Silent())
        assert motion.covariance_of_marks is not None
        # the estimated centre of mass and axes, fixed to the true body as they are in the first frame
        marks = inverse_pose(sequence.X_NG[0]) @ motion.X_NG[0]
        R_NP = sequence.X_NG[:, :3, :3] @ marks[:3, :3] @ motion.mass.R_GP
        arm_N = sequence.X_NG[:, :3, :3] @ (transform_points(marks, motion.mass.com_G[None])[0])
        r_N = sequence.X_NG[:, :3, 3] + arm_N
        truth = sequence.truth
        w_N = np.einsum("fij,fj->fi", truth.R_NP, truth.w_P)
        v_N = truth.v_N + np.cross(w_N, r_N - truth.r_N)
        w_P = np.einsum("fji,fj->fi", R_NP, w_N)
        turn = log_so3(np.swapaxes(R_NP, 1, 2) @ motion.R_NP)
        error = np.hstack([motion.r_N - r_N, motion.v_N - v_N, turn, motion.w_P - w_P])
        later = slice(1, None)
        information = np.linalg.inv(motion.covariance_of_marks[later])
        squares.append(np.einsum("fi,fij,fj->f", error[later], information, error[later]) / 12.0)
        np.testing.assert_allclose(error[0, :3], 0.0, atol=1e-9)
        np.testing.assert_allclose(motion.covariance_of_marks[0, :3, :3], 0.0, atol=1e-12)
    # neighbouring frames err alike, so the mean of 57 of these scatters as that of some ten
    assert 0.6 < np.mean(squares) < 1.6


def test_the_covariance_of_marks_in_the_last_frame_is_that_of_the_prediction() -> None:
    """With offsets of all frames: the same as from the last state jointly with the centre of mass."""
    for w_G in ((0.4, 0.5, 0.45), (0.0, 0.0, 0.8)):
        motion = estimate(w_G)
        assert motion.covariance_of_marks is not None and motion.covariance_last_body is not None
        R_GP, R_NG = motion.mass.R_GP, motion.R_NP[-1] @ motion.mass.R_GP.T
        T = np.zeros((12, 20))
        T[:6, :6] = np.eye(6)
        T[6:9, 6:9] = T[9:12, 9:12] = R_GP.T
        T[:3, 17:], T[3:6, 17:] = -R_NG, -R_NG @ hat(R_GP @ motion.w_P[-1])
        np.testing.assert_allclose(
            motion.covariance_of_marks[-1], T @ motion.covariance_last_body @ T.T, rtol=1e-5, atol=1e-12
        )
        assert np.isfinite(motion.covariance_of_marks).all()
        assert np.linalg.eigvalsh(motion.covariance_of_marks).min() > -1e-12


def test_the_covariance_of_the_gradient_is_that_of_dense_algebra() -> None:
    rng = np.random.default_rng(3)
    frame = np.array([0, 1, 2, 0, 2, 3, 1, 2, 3])
    start = np.array([0, 3, 6, 9])
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
    excess = np.zeros_like(expected)
    found = correlated_scores(
        excess, frame, start, variance, drift, to_pose, to_landmark, E, np.linalg.inv(C), stride
    )
    np.testing.assert_allclose(np.tril(excess), np.tril(expected), atol=1e-9)
    np.testing.assert_allclose(found, own, atol=1e-9)


def solved(seed: int, drift_px: float) -> tuple[SyntheticSequence, MotionData, Iterate]:
    """A tumble whose landmarks slide as it turns, and the motion fitted to it."""
    scene = SyntheticScene(
        frames=40, landmarks=150, detection=0.95, sigma_uv_px=0.2, sigma_d_px=0.2, J_G=BOX,
        w_G=(0.08, 0.1, 0.09), accel_psd=1e-11, torque_psd=1e-11,
    )  # fmt: skip
    sequence = generate(scene, seed)
    data, truth = at_truth(sequence)
    rng, uvd = np.random.default_rng(seed), data.uvd_px.copy()
    turn_rad = turns_between(truth.R_NG, data.R_RN @ truth.R_NG)
    for a, b in pairwise(data.start):
        alike = np.exp(-turn_rad[np.ix_(data.frame[a:b], data.frame[a:b])] / 2.0)
        slide = np.linalg.cholesky(alike + 1e-9 * np.eye(b - a)) @ rng.normal(size=(b - a, 2))
        uvd[a:b, :2] += drift_px * slide
    data = replace(data, uvd_px=uvd, accel_psd=1e-11, torque_psd=1e-11)
    fixed = linearization_point(data, truth)
    iterate = truth.moved_to(GaussNewton(data).solve(fixed, truth.vector(), 30).x)
    return sequence, data.rescaled(estimate_noise(data, iterate, robust=False).factors), iterate


def test_the_errors_of_sliding_landmarks_are_as_large_as_the_covariance_says() -> None:
    nees: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(5):
        sequence, data, iterate = solved(seed, drift_px=0.5)
        solver, fixed, x = GaussNewton(data), linearization_point(data, iterate), iterate.vector()
        residuals, (R_RG, _, _) = solver.residuals(fixed, x)
        turn_rad = turns_between(iterate.R_NG, R_RG)
        to_landmark = observation_jacobians(solver, fixed, x)[1]
        found = measure_correlation(data, residuals, to_landmark, turn_rad)
        assert found is not None
        dependent = DependentErrors(
            found.variance(data), found.drift_between(turn_rad), np.zeros((len(data.frame), 3, 0))
        )
        weight = np.ones(len(data.frame))
        errors = np.concatenate(
            [
                sequence.truth.r_N - FrameStates.of(iterate, data.camera_N).centres(),
                sequence.truth.v_N - iterate.v_N,
            ],
            axis=1,
        )
        for known in (True, False):
            m = marginals(solver, fixed, x, weight, dependent if known else None)
            covariance = state_covariances(iterate, m, body_jacobians(iterate, data.camera_N))[0]
            squares = [e @ np.linalg.solve(c[:6, :6], e) for e, c in zip(errors, covariance, strict=True)]
            nees[known].append(float(np.mean(squares)) / 6.0)
    assert 0.6 < np.mean(nees[True]) < 1.5
    assert np.mean(nees[False]) > 1.4 * np.mean(nees[True])


def test_independent_errors_leave_the_covariance_as_it_is() -> None:
    _, data, iterate = solved(0, drift_px=0.0)
    solver, fixed, x = GaussNewton(data), linearization_point(data, iterate), iterate.vector()
    weight = np.full(len(data.frame), 0.9)
    nothing = DependentErrors(
        np.ones((len(weight), 3)), np.zeros((3, data.n_frames, data.n_frames)), np.zeros((len(weight), 3, 0))
    )
    with_, without = (marginals(solver, fixed, x, weight, c) for c in (nothing, None))
    np.testing.assert_allclose(with_.dense, without.dense, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(with_.landmarks, without.landmarks, rtol=1e-9)
    np.testing.assert_allclose(
        with_.constants_information, without.constants_information, rtol=1e-6, atol=1e-3
    )
