"""The covariance of the last state, along the principal axes and of the body itself."""

import numpy as np

from polhode.backend import estimate_motion, initialize_motion
from polhode.config.backend_settings import Backend
from polhode.lie import Array, hat, inverse_pose, log_so3
from polhode.progress import Silent
from polhode.records import MotionEstimate
from polhode.rigid_fit import mean_rotation
from polhode.simulation.monte_carlo import SyntheticScene, generate

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
