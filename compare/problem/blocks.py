"""Residuals and Jacobians of the common cost, all at once: what external solvers are fed with.

The cost is that of ``backend.gauss_newton.GaussNewton``; here it is split into the blocks of a factor graph.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from polhode.backend.dynamics.kernels import prior_kernel
from polhode.backend.dynamics.residuals import dynamics_jacobians
from polhode.backend.problem.inertia import inertia_derivative
from polhode.backend.problem.iterate import N_CAMERA, N_CONSTANTS, N_STATE
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import wrench_residual
from polhode.backend.solvers.gauss_newton import GaussNewton, camera_errors
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.backend.solvers.robust_kernel import robust_weight
from polhode.lie import Array, hat, right_jacobian_so3
from polhode.records import Ints


@dataclass(frozen=True)
class Block:
    """Residuals of one kind: n of them, each reads the unknowns ``slots`` of its row."""

    residual: Array
    """(n, rows) whitened"""
    jacobian: Array
    """(n, rows, width)"""
    slots: Ints
    """(n, width) in the vector of unknowns"""
    robust: bool = False
    """Under the Cauchy kernel of the squared norm of each row"""


class Blocks:
    """The common cost of a frozen problem, as blocks."""

    def __init__(self, data: MotionData, held: LinearizationPoint) -> None:
        self.data, self.held = data, held
        self._newton = GaussNewton(data)
        self._prior = prior_kernel(data.form, "jacobian")
        at = held.reference
        self.n_state, self.n_states, self.n_dense = at.n_state, at.n_states, at.n_dense
        self.n_x = at.n_dense + 3 * data.n_landmarks

    def cost(self, x: Array) -> float:
        """The one function that every solver is judged by."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self._newton.cost(self.held, x)

    def all(self, x: Array) -> list[Block]:
        """Stereo, dynamics, then the others."""
        return [self.stereo(x), self.dynamics(x), *self.others(x)]

    def stereo_slots(self) -> Ints:
        """(M, 9) pose of the frame, then landmark."""
        d = self.data
        poses = self.n_state * d.frame[:, None] + np.arange(6)
        marks = self.n_dense + 3 * d.landmark[:, None] + np.arange(3)
        return np.hstack([poses, marks])

    def step_slots(self) -> Ints:
        """(F - 1, 2 s + c) state before, state after, constants."""
        steps = np.arange(self.data.n_frames - 1)[:, None]
        states = self.n_state * steps + np.arange(2 * self.n_state)
        constants = np.arange(self.n_states, self.n_dense)
        return np.hstack([states, np.broadcast_to(constants, (len(steps), len(constants)))])

    def stereo(self, x: Array) -> Block:
        """(M, 3) of u, v, disparity, with derivatives in p_NG, theta, p_G."""
        d = self.data
        residual, (A, p_NG, p_G) = self._newton.residuals(self.held, x)
        theta = x[: self.n_states].reshape(-1, self.n_state)[:, 3:6]
        marks, k = p_G[d.landmark], d.frame
        p_R = (A[k] @ marks[:, :, None] + (d.R_RN @ p_NG[:, :, None])[k])[:, :, 0] + d.t_R[k]
        f, baseline = d.rig[0], d.rig[3]
        D, z = np.zeros((len(k), 3, 3)), p_R[:, 2]
        D[:, 0, 0] = D[:, 1, 1] = -f / z
        D[:, 0, 2], D[:, 1, 2] = f * p_R[:, 0] / z**2, f * p_R[:, 1] / z**2
        D[:, 2, 2] = f * baseline / z**2
        D *= d.inv_sigma[:, :, None]
        of_marks = D @ A[k]
        of_theta = -of_marks @ (hat(marks) @ right_jacobian_so3(theta)[k])
        jacobian = np.concatenate([D @ d.R_RN[k], of_theta, of_marks], axis=2)
        return Block(residual, jacobian, self.stereo_slots(), robust=True)

    def dynamics(self, x: Array) -> Block:
        """(F - 1, 12)"""
        states, at = self._newton.states(self.held, x)
        form = self.data.form
        dJ = inertia_derivative(form, at.xi, at.R_inertia)
        residual, jacobian = dynamics_jacobians(states, self.held.steps, at.J_G(form), dJ)
        return Block(residual, jacobian, self.step_slots())

    def others(self, x: Array) -> list[Block]:
        """Weak prior, hold of the first pose; errors of the camera and what is known of a wrench, if any."""
        held, n = self.held, self.n_states
        residual, jacobian = (np.asarray(out) for out in self._prior(x[n : n + N_CONSTANTS], held.prior))
        blocks = [Block(residual.T, jacobian[None], np.arange(n, n + N_CONSTANTS)[None])]
        root = np.sqrt(held.gauge_information)
        offset = np.concatenate([x[:3] - held.reference.p_NG[0], x[3:6]])
        blocks.append(Block((root * offset)[None], np.diag(root)[None], np.arange(6)[None]))
        errors = camera_errors(held, x)
        if len(errors):
            root = np.sqrt(held.camera_information)
            slots = self.n_state * np.arange(len(errors))[:, None] + N_STATE + np.arange(N_CAMERA)
            blocks.append(Block(root * errors, np.tile(np.diag(root), (len(errors), 1, 1)), slots))
        at, form = held.reference.moved_to(x), self.data.form
        if at.wrench is not None and at.R_torque is not None:
            dJ = inertia_derivative(form, at.xi, at.R_inertia)
            r, J = wrench_residual(at.J_G(form), dJ, at.wrench, at.R_torque, held.bias_sigma)
            blocks.append(Block(r[None], J[None], np.arange(n + 3, n + 3 + J.shape[1])[None]))
        return blocks


def root_of_kernel(block: Block, scale: float) -> Block:
    """Residuals whose plain squares are the robust cost, for solvers without kernels of vectors.

    r' = g(s) r with g^2 s = c^2 ln(1 + s / c^2), s = r.r; the Jacobian is exact.
    """
    if not block.robust:
        return block
    r, s = block.residual, np.sum(block.residual**2, axis=1)
    ratio = s / scale**2
    small = ratio < 1e-8
    safe = np.where(small, 1.0, ratio)
    g = np.where(small, 1.0 - ratio / 4.0, np.sqrt(np.log1p(safe) / safe))
    # d ln g / d s
    slope = np.where(small, -0.25 / scale**2, 0.5 * (robust_weight(s, scale) / (g**2 * np.maximum(s, 1e-300)))
                     - 0.5 / np.maximum(s, 1e-300))  # fmt: skip
    along = r[:, None, :] @ block.jacobian
    jacobian = g[:, None, None] * (block.jacobian + 2.0 * slope[:, None, None] * r[:, :, None] * along)
    return Block(g[:, None] * r, jacobian, block.slots)


def stacked(blocks: list[Block], n_x: int) -> tuple[Array, Any]:
    """All residuals (n,) and their Jacobian (n, n_x), sparse by rows."""
    values, columns, lengths = [], [], []
    for block in blocks:
        n, rows, width = block.jacobian.shape
        values.append(block.jacobian.ravel())
        columns.append(np.broadcast_to(block.slots[:, None, :], (n, rows, width)).ravel())
        lengths.append(np.full(n * rows, width))
    residual = np.concatenate([block.residual.ravel() for block in blocks])
    starts = np.concatenate([[0], np.cumsum(np.concatenate(lengths))])
    matrix = csr_matrix((np.concatenate(values), np.concatenate(columns), starts), shape=(len(residual), n_x))
    return residual, matrix
