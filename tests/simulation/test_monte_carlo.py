"""Measurements without images: disturbed motion against its integrals, relative poses of perfect points."""

import numpy as np

from polhode.geometry.lie import exp_so3, inverse_pose, log_so3, make_pose, transform_points
from polhode.geometry.rigid_body import angular_momentum_N, propagate
from polhode.simulation.monte_carlo import disturbed_motion, pair_poses

J = np.array([[1.5, 0.1, 0.0], [0.1, 1.2, -0.05], [0.0, -0.05, 0.9]])
START = (
    np.array([0.1, 0.2, 0.6]),
    np.array([1e-3, 0.0, 2e-3]),
    exp_so3([0.3, 0.2, 0.1]),
    np.array([0.3, 0.8, 0.2]),
)
N, H = 800, 0.02


def test_without_disturbances_it_is_the_free_rigid_body() -> None:
    zero = np.zeros((N, 3))
    r, v, R, w = disturbed_motion(START, J, H, zero, zero)
    expected = propagate(H * np.arange(0.0, N + 1.0, N / 4.0), *START, J)
    for found, wanted in zip((r, v, w), (expected[0], expected[1], expected[3]), strict=True):
        np.testing.assert_allclose(found[:: N // 4], wanted, atol=1e-8)
    assert np.abs(log_so3(np.swapaxes(R[:: N // 4], 1, 2) @ expected[2])).max() < 1e-7


def test_a_step_of_acceleration_and_torque_changes_velocity_and_momentum_by_its_integral() -> None:
    accel, torque = np.zeros((N, 3)), np.zeros((N, 3))
    accel[10], torque[10] = [0.1, -0.2, 0.3], [0.05, 0.02, -0.03]
    r, v, R, w = disturbed_motion(START, J, H, accel, torque)
    np.testing.assert_allclose(v[11] - v[10], H * accel[10], atol=1e-15)
    np.testing.assert_allclose(r[11] - r[10], H * v[10] + 0.5 * H**2 * accel[10], atol=1e-15)
    momentum = angular_momentum_N(J, R, w)
    # the torque turns with the body: Simpson's rule over the step, without what the torque itself does to it
    turned = (R[10] + 4.0 * R[10] @ exp_so3(0.5 * H * w[10]) + R[11]) @ torque[10] / 6.0
    np.testing.assert_allclose(momentum[11] - momentum[10], H * turned, atol=1e-8)
    np.testing.assert_allclose(momentum[12:], np.broadcast_to(momentum[11], momentum[12:].shape), atol=1e-8)


RNG = np.random.default_rng(0)
X_RG = make_pose(exp_so3(RNG.normal(size=(4, 3))), [0.0, 0.0, 0.6] + 0.1 * RNG.normal(size=(4, 3)))
P_G = 0.1 * RNG.normal(size=(30, 3))
SEEN = [np.arange(0, 20), np.arange(10, 30), np.arange(5, 25), np.arange(0, 9)]
FRAME = np.concatenate([np.full(len(points), k) for k, points in enumerate(SEEN)])
POINT = np.concatenate(SEEN)
P_R = transform_points(X_RG[FRAME], P_G[POINT][:, None])[:, 0]


def test_pairs_get_the_true_relative_pose_of_their_good_common_points() -> None:
    i, j, X, count = pair_poses(FRAME, POINT, P_R, X_RG, 0.01, 9)
    assert list(zip(i, j, strict=True)) == [(0, 1), (0, 2), (0, 3), (1, 2)]
    assert list(count) == [10, 15, 9, 15]
    np.testing.assert_allclose(X, X_RG[i] @ inverse_pose(X_RG[j]), atol=1e-12)
    p_R = P_R.copy()
    p_R[(FRAME == 1) & (POINT < 13)] += 0.1
    i, j, X, count = pair_poses(FRAME, POINT, p_R, X_RG, 0.01, 8)
    assert list(zip(i, j, count, strict=True)) == [(0, 2, 15), (0, 3, 9), (1, 2, 12)]
    np.testing.assert_allclose(X, X_RG[i] @ inverse_pose(X_RG[j]), atol=1e-12)
