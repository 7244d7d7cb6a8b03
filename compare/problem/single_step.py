"""The dynamics of one step alone, for libraries that call Python for every block."""

from dataclasses import replace

import numpy as np

from polhode.backend.dynamics.residuals import FrameStates, Steps, dynamics_jacobians, dynamics_residuals
from polhode.backend.problem.inertia import inertia_derivative
from polhode.backend.problem.iterate import N_CONSTANTS
from polhode.compare.problem.blocks import Blocks
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
