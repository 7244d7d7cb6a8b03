"""The rotation over a step as Aghili's filter has it: his three numbers are free in Euler's equation.

``w_x' = p_x w_y w_z`` and so on along the axes P (thesis eqs. 4.86-4.91). Off the surface on which the three
depend on one another no body turns like that: the model has a freedom that the motion lacks. Taylor series
as in ``backend.dynamics.propagation``.
"""

from dataclasses import dataclass

import numpy as np

from polhode.backend.dynamics.propagation import ORDER
from polhode.backend.dynamics.residuals import FrameStates, jacobians_of_propagation
from polhode.backend.dynamics.so3_exp import matrices_from_quaternions
from polhode.compare.problem.blocks import Block, Blocks
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solvers.changed_inertia import ChangedInertia
from polhode.errors import RunFailure
from polhode.lie import Array, exp_so3, hat, right_jacobian_so3
from polhode.records import Ints

N_P = 3


@dataclass
class AghiliDynamics:
    """Residuals of the dynamics of a problem, directly of z."""

    problem: MeasuredProblem
    inertia: ChangedInertia

    def __post_init__(self) -> None:
        if self.problem.held.reference.wrench is not None:
            raise RunFailure("a known torque has no place among free numbers")
        self._blocks = Blocks(self.problem.data, self.problem.held)

    def block(self, z: Array) -> Block:
        """(F - 1, 12) of the states, com_G, p, eta."""
        at, steps = self.problem.held.reference, self.problem.held.steps
        n, s = at.n_states, at.n_state
        of_frames = z[:n].reshape(-1, s)
        states = FrameStates(
            of_frames, at.R_NG @ exp_so3(of_frames[:, 3:6]), self.problem.data.camera_N, z[n : n + 3]
        )
        p, eta = z[self.inertia.of_u], z[self.inertia.of_eta]
        flow = flow_in_G(of_frames[:-1, 9:12], p, self.inertia.R_ref, eta, steps.dt_s, steps.series)
        residual, jacobian = jacobians_of_propagation(states, steps, *flow)
        first = self._blocks.step_slots()[:, : 2 * s]
        constants = np.arange(n, n + 3 + 2 * N_P)
        slots = np.hstack([first, np.broadcast_to(constants, (len(first), len(constants)))])
        return Block(residual, jacobian, slots)

    def instead(self, x: Array, z: Array) -> float:
        """Cost of the dynamics by z, less that of the body nearest to it."""
        with np.errstate(over="ignore", invalid="ignore"):
            own, common = self.block(z).residual, self._blocks.dynamics(x).residual
            return 0.5 * float(np.sum(own**2) - np.sum(common**2))


def flow_in_G(
    w_G: Array, p: Array, R_ref: Array, eta: Array, dt_s: Array, series: Ints
) -> tuple[Array, Array, Array, Array]:
    """As ``backend.dynamics.propagation``, by Aghili's p (3,) along the axes R_ref Exp(eta).

    Attitudes (n, 4) relative to the start, rates (n, 3) [rad/s], derivatives (n, 9, 3) of attitude error
    (right) and rate in w_G, p, eta.
    """
    R = R_ref @ exp_so3(eta)
    w_P = w_G @ R
    q, w_end, turn, rate = flow_in_P(w_P, p, dt_s, series)
    R_step = matrices_from_quaternions(q)
    # rows are parameters: what a turn of the axes by phi does to w_P is w_P x phi
    of_w = np.swapaxes(hat(w_P), 1, 2)
    own_turn, own_rate = R_step - np.eye(3), np.swapaxes(-hat(w_end), 1, 2)
    Jr = right_jacobian_so3(eta)
    turn_eta = Jr.T @ (own_turn + of_w @ turn[:, :3])
    rate_eta = Jr.T @ (own_rate + of_w @ rate[:, :3])
    turn = np.concatenate([R @ turn[:, :3], turn[:, 3:], turn_eta], axis=1) @ R.T
    rate = np.concatenate([R @ rate[:, :3], rate[:, 3:], rate_eta], axis=1) @ R.T
    in_G = np.concatenate([q[:, :1], q[:, 1:] @ R.T], axis=1)
    return in_G, w_end @ R.T, turn, rate


def flow_in_P(w_P: Array, p: Array, dt_s: Array, series: Ints) -> tuple[Array, Array, Array, Array]:
    """Attitudes (n, 4), rates (n, 3), derivatives (n, 6, 3) in w_P and p, along the axes."""
    n, m = len(dt_s), 3 + N_P
    q, w = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), w_P.copy()
    turn, rate = np.zeros((n, m, 3)), np.zeros((n, m, 3))
    rate[:, :3] = np.eye(3)
    for k in range(int(series.max(initial=0))):
        now = np.flatnonzero(series > k)
        h = dt_s[now] / series[now]
        q[now], w[now], turn[now], rate[now] = _one_series(q[now], w[now], turn[now], rate[now], p, h)
    return q, w, turn, rate


def _one_series(
    q: Array, w: Array, turn: Array, rate: Array, p: Array, h: Array
) -> tuple[Array, Array, Array, Array]:
    """All over one Taylor series of length h (n,) [s]."""
    qs, ws, turns, rates = [q], [w], [turn], [rate]
    of_p = np.concatenate([np.zeros((3, 3)), np.eye(3)])
    for k in range(ORDER):
        product, of_product = np.zeros_like(w), np.zeros_like(rate)
        spin, drift = np.zeros_like(q), rates[k].copy()
        for i in range(k + 1):
            a, b = ws[i], ws[k - i]
            product += a[:, [1, 2, 0]] * b[:, [2, 0, 1]]
            da = rates[i]
            of_product += (
                da[:, :, [1, 2, 0]] * b[:, None, [2, 0, 1]] + b[:, None, [1, 2, 0]] * da[:, :, [2, 0, 1]]
            )
            spin += _quaternion_times_rate(qs[k - i], a)
            drift -= np.cross(a[:, None], turns[k - i])
        scale = (h / (k + 1))[:, None]
        qs.append(0.5 * scale * spin)
        ws.append(scale * p * product)
        turns.append(scale[:, :, None] * drift)
        rates.append(scale[:, :, None] * (of_p * product[:, None] + p * of_product))
    end, w, turn, rate = (sum(reversed(terms), np.zeros_like(terms[0])) for terms in (qs, ws, turns, rates))
    return end / np.linalg.norm(end, axis=1, keepdims=True), w, turn, rate


def _quaternion_times_rate(q: Array, w: Array) -> Array:
    """q o (0, w), (n, 4)."""
    vector = q[:, :1] * w + np.cross(q[:, 1:], w)
    return np.concatenate([-np.sum(q[:, 1:] * w, axis=1, keepdims=True), vector], axis=1)
