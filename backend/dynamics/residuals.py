"""Residuals of the rigid-body dynamics between frames, with their Jacobians.

The residual is that of ``kernels.dynamics_residual``, which states it in CasADi. Variables of a step, in this
order: state before, state after, constants. A state consists of p_NG, theta, v_N, w_G (12) and, where the
camera's pose is noisy, b_N and alpha_N (6), the errors of its stated position and attitude: the poses are
those seen from the stated camera pose, the true ones follow by the rotation ``Exp(alpha)`` about the camera
and the shift b.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from polhode.backend.dynamics.propagation import propagate_derivatives, propagate_rotations
from polhode.backend.dynamics.so3_exp import (
    inverse_right_jacobians,
    matrices_from_quaternions,
    right_jacobians,
    rotation_matrices,
    rotation_vectors,
)
from polhode.backend.problem.inertia import N_INERTIA
from polhode.backend.problem.iterate import (
    CAMERA_ROTATION,
    CAMERA_SHIFT,
    COM,
    ERR_R,
    ERR_THETA,
    ERR_V,
    ERR_W,
    N_STATE,
    POSITION,
    RATE,
    ROTATION,
    VELOCITY,
    Iterate,
)  # fmt: skip
from polhode.backend.problem.wrench import FORCE_BIAS, LN_MASS, N_OF_ROTATION, N_WRENCH, torque_in_G
from polhode.geometry.lie import Array, Ints, hat
from polhode.runtime.compiled import compiled

RESIDUALS = 12


@dataclass(frozen=True)
class FrameStates:
    """Values of the unknowns of the frames, s = 12 or 18 numbers each."""

    x: Array
    """(F, s)"""
    R_NG: Array
    """(F, 3, 3) attitudes, including theta"""
    camera_N: Array
    """(F, 3) stated position of the camera [m]"""
    com_G: Array
    """(3,) [m]"""
    wrench: Array | None = None
    """(11,) unknowns of a known wrench (``wrench.py``); None: none acts"""
    R_torque: Array | None = None
    """(3, 3) reference of the torque's axes in G"""

    @staticmethod
    def of(at: Iterate, camera_N: Array) -> "FrameStates":
        """The states of an iterate, whose theta is 0; camera_N (F, 3) stated positions of the camera."""
        numbers = at.vector()[: at.n_states].reshape(-1, at.n_state)
        return FrameStates(numbers, at.R_NG, camera_N, at.com_G, at.wrench, at.R_torque)

    def true_attitudes(self) -> Array:
        """(F, 3, 3) attitudes, corrected for the errors of the camera's attitude."""
        if self.x.shape[1] == N_STATE:
            return self.R_NG
        return rotation_matrices(self.x[:, CAMERA_ROTATION]) @ self.R_NG

    def centres(self) -> Array:
        """(F, 3) true position of the centre of mass in N [m]."""
        seen = self.x[:, POSITION] + self.R_NG @ self.com_G
        if self.x.shape[1] == N_STATE:
            return np.asarray(seen)
        arm = np.einsum("fij,fj->fi", rotation_matrices(self.x[:, CAMERA_ROTATION]), seen - self.camera_N)
        return np.asarray(self.camera_N + self.x[:, CAMERA_SHIFT] + arm)


@dataclass(frozen=True)
class Steps:
    """The steps between frames: lengths, whitening and known wrench, fixed during one solve."""

    dt_s: Array
    """(F - 1,)"""
    series: Ints
    """(F - 1,) number of Taylor series in each"""
    W_t: Array
    """(F - 1, 2, 2) lower, whitens the translation"""
    W_r: Array
    """(F - 1, 6, 6) lower, whitens the rotation"""
    half_log_det: float = 0.0
    """Normalization of the process noise of all steps: makes the costs of different inertias comparable"""
    force_increments: Array | None = None
    """(F - 1, 2, 3) effect of a known force on position [N s^2] and velocity [N s] of 1 kg"""
    torque_P: Array | None = None
    """(F - 1, S, 2, 3) known torque over each series [N m]"""

    @staticmethod
    def none() -> "Steps":
        """No steps."""
        return Steps(np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 2, 2)), np.zeros((0, 6, 6)))

    def part(self, chosen: slice) -> "Steps":
        """Some of the steps; their normalization is not known."""
        arrays = {name: part for name, part in vars(self).items() if isinstance(part, np.ndarray)}
        cut: dict[str, Any] = {name: part[chosen] for name, part in arrays.items()}
        return Steps(**cut)

    def and_then(self, other: "Steps") -> "Steps":
        """These steps, then the others; without known wrench."""
        both: dict[str, Any] = {"half_log_det": self.half_log_det + other.half_log_det}
        for name in ("dt_s", "series", "W_t", "W_r"):
            both[name] = np.concatenate([getattr(self, name), getattr(other, name)])
        return Steps(**both)

    def whiten(self, errors: Array) -> Array:
        """Scale errors (F - 1, 12, ...) of position, velocity, attitude, rate to unit covariance."""
        W = np.zeros((len(self.dt_s), RESIDUALS, RESIDUALS))
        W[:, ERR_R, ERR_R] = self.W_t[:, 0, 0, None, None] * np.eye(3)
        W[:, ERR_V, ERR_R] = self.W_t[:, 1, 0, None, None] * np.eye(3)
        W[:, ERR_V, ERR_V] = self.W_t[:, 1, 1, None, None] * np.eye(3)
        W[:, 6:, 6:] = self.W_r
        return np.asarray(W @ errors)


def dynamics_residuals(states: FrameStates, steps: Steps, J_G: Array) -> Array:
    """Whitened residuals (F - 1, 12); J_G (3, 3) any scale. Infinite where rates are beyond reason."""
    torque, _ = _torque(states, steps)
    q, w_end, _, _ = propagate_rotations(states.x[:-1, RATE], J_G, steps.dt_s, steps.series, torque)
    if not (np.isfinite(q).all() and (np.linalg.norm(q, axis=1) > 0.5).all()):
        return np.full((len(q), RESIDUALS), np.inf)
    errors, _ = _errors(states, steps, matrices_from_quaternions(q), w_end)
    return steps.whiten(errors[:, :, None])[:, :, 0]


def _errors(states: FrameStates, steps: Steps, R_step: Array, w_end: Array) -> tuple[Array, Array]:
    """State after minus predicted state (F - 1, 12), and the true attitudes (F, 3, 3)."""
    x, R, r_N = states.x, states.true_attitudes(), states.centres()
    by_force = _by_force(states, steps)
    dr = r_N[1:] - r_N[:-1] - steps.dt_s[:, None] * x[:-1, VELOCITY] - by_force[:, 0]
    dv = x[1:, VELOCITY] - x[:-1, VELOCITY] - by_force[:, 1]
    dtheta = rotation_vectors(np.swapaxes(R[:-1] @ R_step, 1, 2) @ R[1:])
    return np.hstack([dr, dv, dtheta, x[1:, RATE] - w_end]), R


def _by_force(states: FrameStates, steps: Steps) -> Array:
    """Effect of a known force and its bias on position and velocity, (F - 1, 2, 3)."""
    if states.wrench is None or steps.force_increments is None:
        return np.zeros((len(steps.dt_s), 2, 3))
    of_bias = np.stack([0.5 * steps.dt_s**2, steps.dt_s], axis=1)[:, :, None] * states.wrench[FORCE_BIAS]
    return np.asarray(np.exp(-states.wrench[LN_MASS]) * (steps.force_increments + of_bias))


def _torque(states: FrameStates, steps: Steps) -> tuple[Array | None, Array | None]:
    """A known torque in G, and its derivatives in (xi, ln scale, rotation, bias): (F - 1, S, 12, 2, 3)."""
    if states.wrench is None or states.R_torque is None or steps.torque_P is None:
        return None, None
    torque, of_unknowns = torque_in_G(steps.torque_P, states.wrench, states.R_torque)
    of_xi = np.zeros((*torque.shape[:2], N_INERTIA, 2, 3))
    return torque, np.concatenate([of_xi, of_unknowns], axis=2)


def dynamics_jacobians(states: FrameStates, steps: Steps, J_G: Array, dJ: Array) -> tuple[Array, Array]:
    """Whitened residuals (F - 1, 12) and Jacobians (F - 1, 12, 2 s + c); dJ (5, 3, 3) in xi.

    c = 8 constants com_G, xi, or 19 with the unknowns of a known wrench.
    """
    x = states.x
    torque, dtorque = _torque(states, steps)
    if dtorque is not None:
        dJ = np.concatenate([dJ, np.zeros((N_OF_ROTATION, 3, 3))])
    q, w_end, turn, rate = propagate_derivatives(
        x[:-1, RATE], J_G, dJ, steps.dt_s, steps.series, torque, dtorque
    )
    n, s = len(steps.dt_s), x.shape[1]
    turn, rate, R_step = np.swapaxes(turn, 1, 2), np.swapaxes(rate, 1, 2), matrices_from_quaternions(q)
    errors, R = _errors(states, steps, R_step, w_end)
    of_centre, of_turn = state_derivatives(states)
    n_parameters = turn.shape[2] - 3
    com, at = _shifted(COM, 2 * s), slice(2 * s + 3, 2 * s + 3 + n_parameters)
    D = np.zeros((n, RESIDUALS, at.stop + (0 if states.wrench is None else N_WRENCH - N_OF_ROTATION)))
    D[:, ERR_R, :s], D[:, ERR_R, s : 2 * s] = -of_centre[:-1], of_centre[1:]
    D[:, ERR_R, VELOCITY] -= steps.dt_s[:, None, None] * np.eye(3)
    D[:, ERR_R, com] = R[1:] - R[:-1]
    D[:, ERR_V, VELOCITY], D[:, ERR_V, _shifted(VELOCITY, s)] = -np.eye(3), np.eye(3)
    # rotations before or within the step are expressed at its end
    left = inverse_right_jacobians(errors[:, ERR_THETA])
    back = left @ np.swapaxes(R[1:], 1, 2) @ R[:-1]
    D[:, ERR_THETA, :s], D[:, ERR_THETA, s : 2 * s] = -back @ of_turn[:-1], left @ of_turn[1:]
    of_step = back @ R_step @ turn
    D[:, ERR_THETA, RATE] -= of_step[:, :, :3]
    D[:, ERR_THETA, at] = -of_step[:, :, 3:]
    D[:, ERR_W, _shifted(RATE, s)] = np.eye(3)
    D[:, ERR_W, RATE] = -rate[:, :, :3]
    D[:, ERR_W, at] = -rate[:, :, 3:]
    if states.wrench is not None:
        per_kg, dt = np.exp(-states.wrench[LN_MASS]), steps.dt_s[:, None, None]
        # by the logarithm of the mass, and by the force's bias
        D[:, 0:6, -4] = _by_force(states, steps).reshape(-1, 6)
        D[:, ERR_R, -3:] = -per_kg * 0.5 * dt**2 * np.eye(3)
        D[:, ERR_V, -3:] = -per_kg * dt * np.eye(3)
    return steps.whiten(errors[:, :, None])[:, :, 0], steps.whiten(D)


def _shifted(part: slice, by: int) -> slice:
    """The part of the state after the step, or of the constants, among the variables of a step."""
    return slice(part.start + by, part.stop + by)


def state_derivatives(states: FrameStates) -> tuple[Array, Array]:
    """Derivatives of the true centre of mass and, on the right, of the true attitude: (F, 3, s) each."""
    x, s, R = states.x, states.x.shape[1], states.true_attitudes()
    Jr = right_jacobians(x[:, ROTATION])
    of_centre, of_turn = np.zeros((len(x), 3, s)), np.zeros((len(x), 3, s))
    of_centre[:, :, ROTATION] = -R @ hat(states.com_G) @ Jr
    of_turn[:, :, ROTATION] = Jr
    if s == N_STATE:
        of_centre[:, :, POSITION] = np.eye(3)
        return of_centre, of_turn
    alpha = x[:, CAMERA_ROTATION]
    arm = states.centres() - states.camera_N - x[:, CAMERA_SHIFT]
    left = right_jacobians(-alpha)
    of_centre[:, :, POSITION], of_centre[:, :, CAMERA_SHIFT] = rotation_matrices(alpha), np.eye(3)
    of_centre[:, :, CAMERA_ROTATION] = -hat(arm) @ left
    of_turn[:, :, CAMERA_ROTATION] = np.swapaxes(R, 1, 2) @ left
    return of_centre, of_turn


def add_steps(H: Array, g: Array, residual: Array, jacobian: Array, s: int) -> None:
    """Add ``J^T J`` (both triangles) and ``J^T r`` of every step to the dense system, constants last."""
    square = np.swapaxes(jacobian, 1, 2) @ jacobian
    slope = (np.swapaxes(jacobian, 1, 2) @ residual[:, :, None])[:, :, 0]
    _scatter(H, g, square, slope, s)


@compiled
def _scatter(H: Array, g: Array, square: Array, slope: Array, s: int) -> None:
    n, width = slope.shape
    first = s * (n + 1)
    at = np.empty(width, dtype=np.int64)
    for k in range(n):
        for c in range(width):
            at[c] = s * k + c if c < 2 * s else first + c - 2 * s
        for a in range(width):
            g[at[a]] += slope[k, a]
            for b in range(width):
                H[at[a], at[b]] += square[k, a, b]
