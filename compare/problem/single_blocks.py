"""All stereo measurements of one landmark in one call: for libraries that call Python for every block.

A block for each landmark instead of one for each measurement is a tenth of the calls, and Ceres can still
eliminate the landmarks. The kernel is in the residuals (``blocks.root_of_kernel``).
"""

from dataclasses import replace

import numpy as np

from polhode.backend.dynamics.residuals import FrameStates, Steps, dynamics_jacobians, dynamics_residuals
from polhode.backend.problem.inertia import inertia_derivative
from polhode.backend.problem.iterate import N_CONSTANTS
from polhode.compare.problem.blocks import Blocks
from polhode.compiled import compiled
from polhode.lie import Array, exp_so3


class SingleSteps:
    """Residual (12) and Jacobian (12, 2 s + c) of step k at its own unknowns (2 s + c)."""

    def __init__(self, blocks: Blocks) -> None:
        self.data, self.reference = blocks.data, blocks.held.reference
        steps = blocks.held.steps
        self._steps = [_one(steps, k) for k in range(len(steps.dt_s))]

    def residual(self, k: int, x: Array) -> Array:
        """(12,)"""
        states, J_G, _ = self._at(k, x)
        return np.asarray(dynamics_residuals(states, self._steps[k], J_G)[0])

    def jacobian(self, k: int, x: Array) -> tuple[Array, Array]:
        """(12,), (12, 2 s + c)"""
        states, J_G, constants = self._at(k, x)
        dJ = inertia_derivative(self.data.form, constants[3:N_CONSTANTS], self.reference.R_inertia)
        residual, jacobian = dynamics_jacobians(states, self._steps[k], J_G, dJ)
        return np.asarray(residual[0]), np.asarray(jacobian[0])

    def _at(self, k: int, x: Array) -> tuple[FrameStates, Array, Array]:
        at, s = self.reference, self.reference.n_state
        numbers, constants = x[: 2 * s].reshape(2, s), x[2 * s :]
        R_NG = at.R_NG[k : k + 2] @ exp_so3(numbers[:, 3:6])
        wrench = None if at.wrench is None else constants[N_CONSTANTS:]
        states = FrameStates(numbers, R_NG, self.data.camera_N[k : k + 2], constants[:3], wrench, at.R_torque)
        second = self.data.form.second_moments(constants[3:N_CONSTANTS], at.R_inertia)
        return states, np.trace(second) * np.eye(3) - second, constants


def first_steps(steps: Steps, count: int) -> Steps:
    """So many of the first."""
    return _part(steps, slice(0, count))


def _one(steps: Steps, k: int) -> Steps:
    return _part(steps, slice(k, k + 1))


def _part(steps: Steps, only: slice) -> Steps:
    return replace(
        steps,
        dt_s=steps.dt_s[only],
        series=steps.series[only],
        W_t=steps.W_t[only],
        W_r=steps.W_r[only],
        force_increments=None if steps.force_increments is None else steps.force_increments[only],
        torque_P=None if steps.torque_P is None else steps.torque_P[only],
    )


@compiled
def landmark_block(
    poses: Array, p_G: Array, A_ref: Array, R_RN: Array, t_R: Array, uvd: Array, inv_sigma: Array, rig: Array,
    scale: float, of_poses: Array, of_mark: Array,
) -> Array:  # fmt: skip
    """Residuals (n, 3) of n frames that see the landmark; fills of_poses (n, 3, 6) and of_mark (n, 3, 3).

    poses (n, 6): p_NG, theta around the reference; A_ref (n, 3, 3) = R_RN R_ref.
    """
    n = len(poses)
    out = np.empty((n, 3))
    D, T = np.zeros((3, 3)), np.empty((3, 3))
    for m in range(n):
        turn, right = _turn(poses[m, 3:6])
        A = A_ref[m] @ turn
        p = A @ p_G + R_RN[m] @ np.ascontiguousarray(poses[m, 0:3]) + t_R[m]
        x, y, z = p[0], p[1], p[2]
        f, fb = rig[0], rig[0] * rig[3]
        r0 = (uvd[m, 0] - f * x / z - rig[1]) * inv_sigma[m, 0]
        r1 = (uvd[m, 1] - f * y / z - rig[2]) * inv_sigma[m, 1]
        r2 = (uvd[m, 2] - fb / z - rig[4]) * inv_sigma[m, 2]
        D[0, 0], D[0, 2] = -f / z * inv_sigma[m, 0], f * x / z**2 * inv_sigma[m, 0]
        D[1, 1], D[1, 2] = -f / z * inv_sigma[m, 1], f * y / z**2 * inv_sigma[m, 1]
        D[2, 2] = fb / z**2 * inv_sigma[m, 2]
        J_mark = D @ A
        T[0, 0], T[0, 1], T[0, 2] = 0.0, p_G[2], -p_G[1]
        T[1, 0], T[1, 1], T[1, 2] = -p_G[2], 0.0, p_G[0]
        T[2, 0], T[2, 1], T[2, 2] = p_G[1], -p_G[0], 0.0
        J_turn, J_place = J_mark @ T @ right, D @ R_RN[m]
        # the kernel: r' = g r with g^2 s = c^2 ln(1 + s / c^2)
        s = r0 * r0 + r1 * r1 + r2 * r2
        ratio = s / scale**2
        if ratio < 1e-8:
            g, slope = 1.0 - ratio / 4.0, -0.25 / scale**2
        else:
            g = np.sqrt(np.log1p(ratio) / ratio)
            slope = 0.5 / (1.0 + ratio) / (g * g * s) - 0.5 / s
        r = (r0, r1, r2)
        for c in range(3):
            place = r0 * J_place[0, c] + r1 * J_place[1, c] + r2 * J_place[2, c]
            turned = r0 * J_turn[0, c] + r1 * J_turn[1, c] + r2 * J_turn[2, c]
            mark = r0 * J_mark[0, c] + r1 * J_mark[1, c] + r2 * J_mark[2, c]
            for i in range(3):
                of_poses[m, i, c] = g * (J_place[i, c] + 2.0 * slope * r[i] * place)
                of_poses[m, i, 3 + c] = g * (J_turn[i, c] + 2.0 * slope * r[i] * turned)
                of_mark[m, i, c] = g * (J_mark[i, c] + 2.0 * slope * r[i] * mark)
        out[m, 0], out[m, 1], out[m, 2] = g * r0, g * r1, g * r2
    return out


@compiled
def _turn(theta: Array) -> tuple[Array, Array]:
    """Exp(theta) and its right Jacobian, (3, 3) each."""
    a = np.sqrt(theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2)
    if a < 1e-4:
        s, c, j = 1.0 - a * a / 6.0, 0.5 - a * a / 24.0, 1.0 / 6.0 - a * a / 120.0
    else:
        s, c, j = np.sin(a) / a, (1.0 - np.cos(a)) / a**2, (a - np.sin(a)) / a**3
    K = np.array([[0.0, -theta[2], theta[1]], [theta[2], 0.0, -theta[0]], [-theta[1], theta[0], 0.0]])
    square = K @ K
    return np.eye(3) + s * K + c * square, np.eye(3) - c * K + j * square


def compile_block() -> None:
    """Compile the loop, or load it: the first time on a machine takes seconds."""
    one, three = np.ones((1, 3, 3)), np.ones((1, 3))
    fixed = (one, one, three, three, three, np.ones(5))
    landmark_block(np.zeros((1, 6)), np.ones(3), *fixed, 3.0, np.empty((1, 3, 6)), np.empty((1, 3, 3)))
