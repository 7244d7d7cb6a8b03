"""Residuals and Jacobians of the common cost as blocks of a factor graph, for external solvers.

The cost is that of ``backend.solvers.gauss_newton.GaussNewton``. Libraries that call Python for every block
get all measurements of a landmark as one: that needs a tenth of the calls, and Ceres can still eliminate the
landmarks.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from polhode.backend.dynamics.kernels import prior_kernel
from polhode.backend.dynamics.residuals import FrameStates, dynamics_jacobians, dynamics_residuals
from polhode.backend.dynamics.so3_exp import contiguous_right_jacobians, contiguous_rotation_matrices
from polhode.backend.problem.inertia import inertia_derivative, inertia_from_second_moments
from polhode.backend.problem.iterate import N_CAMERA, N_CONSTANTS, N_STATE
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import wrench_residual
from polhode.backend.solvers.gauss_newton import camera_errors
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.geometry.lie import Array, Ints, exp_so3
from polhode.runtime.compiled import compiled

Evaluation = Callable[[Array, bool], tuple[Array, Array]]
"""(Own unknowns of a block, whether the Jacobian is needed) -> residuals (rows,), Jacobian (rows, width)."""


@dataclass(frozen=True)
class Block:
    """Residuals of one kind: n of them, each reads the unknowns ``slots`` of its row."""

    residual: Array
    """(n, rows) whitened"""
    jacobian: Array
    """(n, rows, width)"""
    slots: Ints
    """(n, width) in the vector of unknowns"""


class Blocks:
    """The steps, priors and gauge of a frozen problem, each as a function of its own unknowns."""

    def __init__(self, data: MotionData, fixed: LinearizationPoint) -> None:
        self.data, self.fixed = data, fixed
        self._prior = prior_kernel(data.form, "jacobian")
        at = fixed.reference
        self.n_state, self.n_states, self.n_dense = at.n_state, at.n_states, at.n_dense

    def others(self, x: Array) -> list[Block]:
        """Weak prior, gauge of the first pose; errors of the camera and prior of a known wrench, if any."""
        fixed, n = self.fixed, self.n_states
        residual, jacobian = (np.asarray(out) for out in self._prior(x[n : n + N_CONSTANTS], fixed.prior))
        blocks = [Block(residual.T, jacobian[None], np.arange(n, n + N_CONSTANTS)[None])]
        root = np.sqrt(fixed.gauge_information)
        offset = np.concatenate([x[:3] - fixed.reference.p_NG[0], x[3:6]])
        blocks.append(Block((root * offset)[None], np.diag(root)[None], np.arange(6)[None]))
        errors = camera_errors(fixed, x)
        if len(errors):
            root = np.sqrt(fixed.camera_information)
            slots = self.n_state * np.arange(len(errors))[:, None] + N_STATE + np.arange(N_CAMERA)
            blocks.append(Block(root * errors, np.tile(np.diag(root), (len(errors), 1, 1)), slots))
        at, form = fixed.reference.moved_to(x), self.data.form
        if at.wrench is not None and at.R_torque is not None:
            dJ = inertia_derivative(form, at.xi, at.R_inertia)
            r, J = wrench_residual(at.J_G(form), dJ, at.wrench, at.R_torque, fixed.bias_sigma)
            blocks.append(Block(r[None], J[None], np.arange(n + 3, n + 3 + J.shape[1])[None]))
        return blocks

    def step(self, k: int) -> Evaluation:
        """The 12 residuals of step k, of states before and after and constants (2 s + c)."""
        at, s, form = self.fixed.reference, self.n_state, self.data.form
        camera_N, steps = self.data.camera_N[k : k + 2], self.fixed.steps.part(slice(k, k + 1))

        def evaluate(x: Array, with_jacobian: bool) -> tuple[Array, Array]:
            numbers, constants = x[: 2 * s].reshape(2, s), x[2 * s :]
            R_NG = at.R_NG[k : k + 2] @ exp_so3(numbers[:, 3:6])
            wrench = None if at.wrench is None else constants[N_CONSTANTS:]
            states = FrameStates(numbers, R_NG, camera_N, constants[:3], wrench, at.R_torque)
            xi = constants[3:N_CONSTANTS]
            J_G = inertia_from_second_moments(form.second_moments(xi, at.R_inertia))
            if not with_jacobian:
                return np.asarray(dynamics_residuals(states, steps, J_G)[0]), np.zeros((0, 0))
            dJ = inertia_derivative(form, xi, at.R_inertia)
            residual, jacobian = dynamics_jacobians(states, steps, J_G, dJ)
            return np.asarray(residual[0]), np.asarray(jacobian[0])

        return evaluate

    def prior(self, kind: int, row: int, x: Array, slots: Ints) -> Evaluation:
        """A row of ``others`` as a function of the unknowns ``slots``; the other unknowns are those of x."""
        x, block = x.copy(), self.others(x)[kind]
        columns = [int(np.flatnonzero(slots == slot)[0]) for slot in block.slots[row]]

        def evaluate(own: Array, _: bool) -> tuple[Array, Array]:
            x[slots] = own
            block = self.others(x)[kind]
            jacobian = np.zeros((block.residual.shape[1], len(slots)))
            jacobian[:, columns] = block.jacobian[row]
            return np.asarray(block.residual[row]), jacobian

        return evaluate


@compiled
def landmark_block(
    poses: Array, p_G: Array, A_ref: Array, R_RN: Array, t_R: Array, uvd: Array, inv_sigma: Array, rig: Array,
    scale: float, of_poses: Array, of_landmark: Array,
) -> Array:  # fmt: skip
    """Residuals (n, 3) of n frames that see the landmark; fills of_poses (n, 3, 6) and of_landmark (n, 3, 3).

    Their plain squares are the robust cost: r' = g r with g^2 s = c^2 ln(1 + s / c^2), s = r.r.
    poses (n, 6): p_NG, theta around the reference; A_ref (n, 3, 3) = R_RN R_ref.
    """
    n = len(poses)
    out = np.empty((n, 3))
    theta = np.ascontiguousarray(poses[:, 3:6])
    rotation, right = contiguous_rotation_matrices(theta), contiguous_right_jacobians(theta)
    D, T = np.zeros((3, 3)), np.empty((3, 3))
    for m in range(n):
        A = A_ref[m] @ rotation[m]
        p = A @ p_G + R_RN[m] @ np.ascontiguousarray(poses[m, 0:3]) + t_R[m]
        x, y, z = p[0], p[1], p[2]
        f, fb = rig[0], rig[0] * rig[3]
        predicted = np.array([f * x / z + rig[1], f * y / z + rig[2], fb / z + rig[4]])
        r = (uvd[m] - predicted) * inv_sigma[m]
        D[0, 0], D[0, 2] = -f / z * inv_sigma[m, 0], f * x / z**2 * inv_sigma[m, 0]
        D[1, 1], D[1, 2] = -f / z * inv_sigma[m, 1], f * y / z**2 * inv_sigma[m, 1]
        D[2, 2] = fb / z**2 * inv_sigma[m, 2]
        J_landmark = D @ A
        T[0, 0], T[0, 1], T[0, 2] = 0.0, p_G[2], -p_G[1]
        T[1, 0], T[1, 1], T[1, 2] = -p_G[2], 0.0, p_G[0]
        T[2, 0], T[2, 1], T[2, 2] = p_G[1], -p_G[0], 0.0
        J_rotation, J_position = J_landmark @ T @ right[m], D @ R_RN[m]
        s = r @ r
        ratio = s / scale**2
        if ratio < 1e-8:
            g, slope = 1.0 - ratio / 4.0, -0.25 / scale**2
        else:
            g = np.sqrt(np.log1p(ratio) / ratio)
            slope = 0.5 / (1.0 + ratio) / (g * g * s) - 0.5 / s
        J = np.concatenate((J_position, J_rotation, J_landmark), axis=1)
        J = g * (J + 2.0 * slope * np.outer(r, r @ J))
        of_poses[m], of_landmark[m] = J[:, :6], J[:, 6:]
        out[m] = g * r
    return out


def compile_block() -> None:
    """Compile the loop, or load it: the first time on a machine takes seconds."""
    one, three = np.ones((1, 3, 3)), np.ones((1, 3))
    fixed = (one, one, three, three, three, np.ones(5))
    landmark_block(np.zeros((1, 6)), np.ones(3), *fixed, 3.0, np.empty((1, 3, 6)), np.empty((1, 3, 3)))
