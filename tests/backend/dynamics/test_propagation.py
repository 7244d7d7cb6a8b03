"""The motion over one step against an integrator that shares nothing with it, and its derivatives."""

import numpy as np
import pytest

from polhode.backend.dynamics.process_noise import rotation_covariance_scaled
from polhode.backend.dynamics.propagation import (
    SHARE_OF_NOISE,
    propagate_derivatives,
    propagate_rotations,
    series_steps,
)
from polhode.geometry.lie import Array, log_so3, matrix_from_wxyz
from polhode.geometry.rigid_body import propagate

BODIES = {
    "box": np.diag([1.5, 1.2, 0.9]),
    "nearly a sphere": np.diag([2.41, 2.34, 2.01]),
    "plate": np.diag([1.0, 0.6, 0.42]),
}
DIRECTIONS = np.array([[1.0, 0.1, 0.05], [0.05, 1.0, 0.05], [0.6, 0.7, 0.5]])
RPM = 2.0 * np.pi / 60.0


@pytest.mark.parametrize("psd", [1e-6, 1e-9])
@pytest.mark.parametrize("dt_s", [1e-3, 0.1, 1.0, 10.0])
@pytest.mark.parametrize("body", BODIES)
def test_the_error_stays_below_a_thousandth_of_the_process_noise(body: str, dt_s: float, psd: float) -> None:
    J = BODIES[body] / np.linalg.eigvalsh(BODIES[body])[1]
    rates = np.concatenate(
        [rpm * RPM * DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, None] for rpm in (1, 20)]
    )
    dt = np.full(len(rates), dt_s)
    steps = series_steps(rates, J, dt, psd)
    cov, scale = rotation_covariance_scaled(rates, J, dt, psd)
    q, w_end, _, _ = propagate_rotations(rates, J, dt, steps)
    for k, w in enumerate(rates):
        _, _, R, w_true = propagate([0.0, dt_s], np.zeros(3), np.zeros(3), np.eye(3), w, J)
        error = np.concatenate([log_so3(R[1].T @ matrix_from_wxyz(q[k])), w_end[k] - w_true[1]]) / scale[k]
        assert np.linalg.norm(np.linalg.solve(np.linalg.cholesky(cov[k]), error)) < SHARE_OF_NOISE


def test_fast_or_long_steps_take_more_series_and_short_ones_a_single_one() -> None:
    w, box = np.array([[0.1, 1.0, 0.1]]), BODIES["box"]
    assert series_steps(w, box, np.array([0.3]), 1e-6)[0] == 1
    assert 16 <= series_steps(2.0 * w, box, np.array([10.0]), 1e-6)[0] <= 64


def test_derivatives_match_finite_differences() -> None:
    rng = np.random.default_rng(0)
    J = BODIES["box"] + 0.1 * np.ones((3, 3))
    dJ = rng.normal(size=(2, 3, 3))
    dJ += np.swapaxes(dJ, 1, 2)
    w, steps, step, dt = np.array([[0.4, 1.0, -0.3]]), np.array([8]), 1e-6, np.array([0.7])
    torque, dtorque = rng.normal(size=(1, 8, 2, 3)), rng.normal(size=(1, 8, 2, 2, 3))
    q, w_end, turn, rate = propagate_derivatives(w, J, dJ, dt, steps, torque, dtorque)
    R = matrix_from_wxyz(q)[0]
    for row in range(5):
        ends = []
        for sign in (-step, step):
            w_moved, J_moved, torque_moved = w.copy(), J, torque
            if row < 3:
                w_moved[0, row] += sign
            else:
                J_moved, torque_moved = J + sign * dJ[row - 3], torque + sign * dtorque[:, :, row - 3]
            at = propagate_rotations(w_moved, J_moved, dt, steps, torque_moved)
            ends.append((log_so3(R.T @ matrix_from_wxyz(at[0][0])), at[1][0]))
        np.testing.assert_allclose(turn[0, row], (ends[1][0] - ends[0][0]) / (2 * step), rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(rate[0, row], (ends[1][1] - ends[0][1]) / (2 * step), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(w_end, propagate_rotations(w, J, dt, steps, torque)[1], rtol=1e-12)


def test_a_torque_that_changes_linearly_is_integrated_as_such() -> None:
    J, w, dt = BODIES["box"], np.array([0.3, 0.2, -0.4]), 0.8
    start, slope = np.array([0.2, -0.1, 0.3]), np.array([-0.3, 0.2, 0.1])

    def wrench(t: float) -> tuple[Array, Array]:
        return np.zeros(3), start + slope * t

    _, _, R, w_true = propagate([0.0, dt], np.zeros(3), np.zeros(3), np.eye(3), w, J, wrench)
    # value at the start of each of two series, and the change over it
    torque = np.array([[[start, 0.4 * slope], [start + 0.4 * slope, 0.4 * slope]]])
    q, w_end, _, _ = propagate_rotations(w[None], J, np.array([dt]), np.array([2]), torque)
    np.testing.assert_allclose(w_end[0], w_true[1], atol=1e-9)
    np.testing.assert_allclose(matrix_from_wxyz(q[0]), R[1], atol=1e-9)
