"""Undisturbed it is the free rigid body; disturbances add what their integral says."""

import numpy as np

from polhode.lie import exp_so3, log_so3
from polhode.rigid_body import angular_momentum_N, propagate
from polhode.simulation.monte_carlo import disturbed_motion

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
