"""Follows a free body by poses of an edge tracker: an error-state Kalman filter of the relative motion.

State: r_N, v_N of the target's centre of mass seen from the camera, along the inertial axes N; attitude R_NP
of its principal axes; rate w_P. Errors (12,): of r, v in N, theta in R_NP Exp(theta), of w in P, as in
`planning.prediction`. The camera's attitude R_NR and the inspector's acceleration are known. A measurement is
a pose X_RG with the information (6, 6) of its error in the sense of `edge_motion.pose_error`. What it does
not tell has no information, rather than a large variance: the update is made in the directions that it tells,
in Joseph's form (Bucy and Joseph, "Filtering for stochastic processes with applications to guidance", 1968).
After it the attitude's error is reset (Sola, "Quaternion kinematics for the error-state Kalman filter", 2017,
section 6.3).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2

from benchmarks.navigation.free_rotation import turn_freely
from polhode.lie import Array, exp_so3, hat, inverse_pose, log_so3, make_pose, right_jacobian_so3
from polhode.planning.edges.metric.edge_motion import pose_error

UNTOLD_SHARE = 1e-9
"""A direction with less than this share of the largest information, shifts in radii, is not told."""


@dataclass(frozen=True)
class Target:
    """What is known of the body, and of what disturbs it."""

    moments: Array
    """(3,) principal moments of inertia, middle one 1"""
    X_GP: Array
    """(4, 4) its principal axes and centre of mass in the model's frame"""
    o_G: Array
    """(3,) the point that errors of measured poses are told about [m]"""
    radius_m: float
    """half its diameter: with it shifts and turns are compared"""
    accel_psd: float = 0.0
    """[(m/s^2)^2/Hz]"""
    torque_psd: float = 0.0
    """[(rad/s^2)^2/Hz], torque over the middle moment"""


@dataclass(frozen=True)
class State:
    """The relative motion at one instant."""

    r_N: Array
    """(3,) from the camera to the centre of mass [m]"""
    v_N: Array
    """(3,) [m/s]"""
    R_NP: Array
    """(3, 3)"""
    w_P: Array
    """(3,) [rad/s]"""
    covariance: Array
    """(12, 12)"""

    def plus(self, error: Array) -> "State":
        """The state that is off by error (12,), with the same covariance."""
        return State(
            self.r_N + error[:3],
            self.v_N + error[3:6],
            self.R_NP @ exp_so3(error[6:9]),
            self.w_P + error[9:],
            self.covariance,
        )

    def error(self, true: "State") -> Array:
        """(12,) by which it is off the true one: true.plus(error) is this one."""
        turn = log_so3(true.R_NP.T @ self.R_NP)
        return np.concatenate([self.r_N - true.r_N, self.v_N - true.v_N, turn, self.w_P - true.w_P])

    def nees(self, true: "State") -> float:
        """Squared error over its covariance; 12 on average where that is right."""
        error = true.error(self)
        return float(error @ cho_solve(cho_factor(self.covariance), error))


@dataclass(frozen=True)
class Update:
    """A state after a measurement, and how the two agreed."""

    state: State
    nis: float
    """squared innovation over its covariance"""
    told: int
    """directions that the measurement told: what nis is on average"""
    taken: bool
    """False: refused by the gate"""


def predict(state: State, target: Target, dt_s: float, accel_N: Array) -> State:
    """The state after dt_s > 0 [s] of free motion; accel_N (3,) of the inspector in this time [m/s^2]."""
    turn, w_P, Phi, Q = turn_freely(target.moments, state.w_P, dt_s, target.torque_psd)
    F, noise, one = np.eye(12), np.zeros((12, 12)), np.eye(3)
    F[:3, 3:6] = dt_s * one
    F[6:, 6:], noise[6:, 6:] = Phi, Q
    noise[:3, :3] = target.accel_psd * dt_s**3 / 3.0 * one
    noise[:3, 3:6] = noise[3:6, :3] = target.accel_psd * dt_s**2 / 2.0 * one
    noise[3:6, 3:6] = target.accel_psd * dt_s * one
    return State(
        state.r_N + dt_s * state.v_N - 0.5 * dt_s**2 * accel_N,
        state.v_N - dt_s * accel_N,
        state.R_NP @ turn,
        w_P,
        F @ state.covariance @ F.T + noise,
    )


def predicted_pose(state: State, target: Target, R_NR: Array) -> Array:
    """X_RG (4, 4) that a camera of attitude R_NR (3, 3) should measure."""
    X_RP = make_pose(R_NR.T @ state.R_NP, R_NR.T @ state.r_N)
    return np.asarray(X_RP @ inverse_pose(target.X_GP))


def measurement_jacobian(state: State, target: Target, R_NR: Array) -> Array:
    """Derivative (6, 12) of the measured pose's change, shift of o and turn in R, by the state's error."""
    lever_P = inverse_pose(target.X_GP) @ np.append(target.o_G, 1.0)
    R_RP = R_NR.T @ state.R_NP
    H = np.zeros((6, 12))
    H[:3, :3] = R_NR.T
    H[:3, 6:9] = -R_RP @ hat(lever_P[:3])
    H[3:, 6:9] = R_RP
    return H


def told_directions(information: Array, radius_m: float) -> tuple[Array, Array]:
    """Directions D (k, 6) that information (6, 6) tells, and variances (k,) of D @ error, uncorrelated."""
    scale = np.array([radius_m] * 3 + [1.0] * 3)
    values, directions = np.linalg.eigh(information * np.outer(scale, scale))
    told = values > max(UNTOLD_SHARE * float(values[-1]), 0.0)
    # scaled information V L V^T: V^T (error / scale) has variances 1 / L
    return np.asarray(directions[:, told].T / scale), 1.0 / values[told]


def update(
    state: State,
    target: Target,
    R_NR: Array,
    X_RG: Array,
    information: Array,
    gate: float | None = None,
) -> Update:
    """The state after a measured pose X_RG (4, 4) of information (6, 6), which may be singular.

    gate: the probability that a right measurement passes; one that is farther off is refused.
    """
    D, variance = told_directions(information, target.radius_m)
    told = len(variance)
    if told == 0:
        return Update(state, 0.0, 0, False)
    innovation = D @ pose_error(X_RG, predicted_pose(state, target, R_NR), target.o_G)
    H = D @ measurement_jacobian(state, target, R_NR)
    P = state.covariance
    S = cho_factor(H @ P @ H.T + np.diag(variance))
    nis = float(innovation @ cho_solve(S, innovation))
    if gate is not None and nis > float(chi2.ppf(gate, told)):
        return Update(state, nis, told, False)
    K = cho_solve(S, H @ P).T
    error = K @ innovation
    rest = np.eye(12) - K @ H
    P = rest @ P @ rest.T + (K * variance) @ K.T
    reset = np.eye(12)
    reset[6:9, 6:9] = right_jacobian_so3(error[6:9])
    P = reset @ P @ reset.T
    moved = state.plus(error)
    return Update(State(moved.r_N, moved.v_N, moved.R_NP, moved.w_P, 0.5 * (P + P.T)), nis, told, True)
