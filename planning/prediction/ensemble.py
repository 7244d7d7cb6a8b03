"""The body's frame G ahead of the last pair: as predicted, and in members drawn from what is not known of it.

Members differ in the last state and the inertia, drawn from their joint covariance as in
``planning.prediction``, and in a path of white disturbances (thesis eqs. 4.56-4.59) of the level that the run
found. Poses are those of G: what a point fixed to the body does, whether or not its axes are known.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from polhode.lie import Array, exp_so3, hat, log_so3, make_pose
from polhode.planning.prediction.prediction import FinalState, draw_deviations, propagate_members
from polhode.rigid_body import angular_acceleration, propagate

MEMBERS_AT_ONCE = 250


@dataclass(frozen=True)
class FinalEstimate:
    """What is known of the target at the end of a run: where members come from."""

    last: FinalState
    com_G: Array
    """(3,) [m]"""
    accel_psd: float
    """[(m/s^2)^2/Hz]"""
    torque_psd: float
    """[(rad/s^2)^2/Hz], torque over the middle moment"""


@dataclass(frozen=True)
class BodyMotion:
    """The estimate, carried on to T instants."""

    time_s: Array
    """(T,) after the last pair"""
    R_NG: Array
    """(T, 3, 3)"""
    p_NG: Array
    """(T, 3) origin of G [m]"""
    com_N: Array
    """(T, 3) [m]"""
    v_N: Array
    """(T, 3) velocity of the centre of mass [m/s]"""
    w_N: Array
    """(T, 3) [rad/s]"""
    w_dot_N: Array
    """(T, 3) [rad/s^2]"""

    @property
    def X_NG(self) -> Array:
        """(T, 4, 4)"""
        return make_pose(self.R_NG, self.p_NG)


@dataclass(frozen=True)
class Ensemble:
    """Poses of G in n drawn members at T instants."""

    R_NG: Array
    """(n, T, 3, 3)"""
    p_NG: Array
    """(n, T, 3) [m]"""

    def part(self, chosen: slice) -> "Ensemble":
        """Some of them."""
        return Ensemble(self.R_NG[chosen], self.p_NG[chosen])


def nominal_motion(estimate: FinalEstimate, time_s: Array) -> BodyMotion:
    """The estimate at times (T,) >= 0 [s], increasing."""
    last, grid = estimate.last, time_s if time_s[0] == 0.0 else np.concatenate([[0.0], time_s])
    states = propagate(grid, last.r_N, last.v_N, last.R_NG, last.w_G, last.J_G, rtol=1e-10)
    r_N, v_N, R_NG, w_G = (each[len(grid) - len(time_s) :] for each in states)
    w_dot_G = angular_acceleration(last.J_G, w_G)
    return BodyMotion(
        time_s,
        R_NG,
        r_N - R_NG @ estimate.com_G,
        r_N,
        v_N,
        np.einsum("tij,tj->ti", R_NG, w_G),
        np.einsum("tij,tj->ti", R_NG, w_dot_G),
    )


def draw_ensemble(estimate: FinalEstimate, time_s: Array, count: int, seed: int) -> Ensemble:
    """Independent members at times (T,) > 0 [s], increasing; the same seed gives the same members."""
    rng = np.random.default_rng([seed, 8])
    R_all = np.empty((count, len(time_s), 3, 3))
    p_all = np.empty((count, len(time_s), 3))
    pushed = DisturbancePaths(estimate, time_s)
    for start in range(0, count, MEMBERS_AT_ONCE):
        n = min(MEMBERS_AT_ONCE, count - start)
        deviation, J = draw_deviations(estimate.last, rng.normal(size=(n, 20)))
        R, _ = propagate_members(estimate.last, deviation, J, time_s)
        shift, turn_G = pushed.paths(n, rng)
        R = np.swapaxes(R, 0, 1) @ exp_so3(turn_G)
        r = estimate.last.r_N + deviation[:, None, 0:3]
        r = r + time_s[:, None] * (estimate.last.v_N + deviation[:, None, 3:6]) + shift
        R_all[start : start + n] = R
        com = estimate.com_G + deviation[:, 17:20]
        p_all[start : start + n] = r - np.einsum("ntij,nj->nti", R, com)
    return Ensemble(R_all, p_all)


class DisturbancePaths:
    """White accelerations and torques, as paths of the place and the attitude about the estimate's motion."""

    def __init__(self, estimate: FinalEstimate, time_s: Array) -> None:
        """Prepares the steps between times (T,) > 0 [s], the first one from 0."""
        last = estimate.last
        self.step_s = np.diff(time_s, prepend=0.0)
        self.accel_psd, self.R_GP = estimate.accel_psd, last.R_GP
        moments = np.diag(last.R_GP.T @ last.J_G @ last.R_GP)
        moments = moments / moments[1]
        middle = time_s - 0.5 * self.step_s
        states = propagate(
            np.concatenate([[0.0], middle]),
            np.zeros(3),
            np.zeros(3),
            last.R_NG,
            last.w_G,
            last.J_G,
            rtol=1e-8,
        )
        w = states[3][1:] @ last.R_GP
        # theta' = -w x theta + dw;  dw' = J^-1 ((J w) x - w x J) dw, the rate of the middle held over a step
        A = np.zeros((len(time_s), 6, 6))
        A[:, :3, :3], A[:, :3, 3:] = -hat(w), np.eye(3)
        A[:, 3:, 3:] = (hat(moments * w) - hat(w) * moments) / moments[:, None]
        S = np.zeros((6, 6))
        S[3:, 3:] = estimate.torque_psd * np.diag(1.0 / moments**2)
        half = expm(0.5 * self.step_s[:, None, None] * A)
        self.flow = half @ half
        # Simpson's rule for the integral of what each instant adds
        grown = self.flow @ S @ np.swapaxes(self.flow, 1, 2) + S
        grown = grown + 4.0 * half @ S @ np.swapaxes(half, 1, 2)
        values, vectors = np.linalg.eigh(self.step_s[:, None, None] / 6.0 * grown)
        self.root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]

    def paths(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Shifts of the place along N [m] and turns along G [rad], (count, T, 3) each."""
        T = len(self.step_s)
        shift, turn = np.empty((count, T, 3)), np.empty((count, T, 3))
        x, r, v = np.zeros((count, 6)), np.zeros((count, 3)), np.zeros((count, 3))
        for k, dt in enumerate(self.step_s):
            x = x @ self.flow[k].T + rng.normal(size=(count, 6)) @ self.root[k].T
            kick, inside = rng.normal(size=(2, count, 3)) * np.sqrt(self.accel_psd * dt)
            r = r + dt * (v + 0.5 * kick + inside / np.sqrt(12.0))
            v = v + kick
            shift[:, k], turn[:, k] = r, x[:, :3] @ self.R_GP.T
        return shift, turn


def pose_covariance(members: Ensemble, motion: BodyMotion) -> Array:
    """Second moments (T, 6, 6) of shift [m] and turn [rad] along G: p_N = X_NG (Exp(turn) p_G + shift)."""
    back = np.swapaxes(motion.R_NG, 1, 2)
    shift = np.einsum("tij,ntj->nti", back, members.p_NG - motion.p_NG)
    turn = log_so3(back @ members.R_NG)
    both = np.concatenate([shift, turn], axis=-1)
    return np.asarray(np.einsum("nti,ntj->tij", both, both) / len(both))
