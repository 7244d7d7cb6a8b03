"""Follows a free body by poses of an edge tracker: an error-state Kalman filter of the relative motion.

State: r_N, v_N of the target's centre of mass seen from the camera, along the inertial axes N; attitude R_NP
of its principal axes; rate w_P. Errors (12,): of r, v in N, theta in R_NP Exp(theta), of w in P, as in
`planning.prediction`. The camera's attitude R_NR and the inspector's acceleration are known. A measurement is
a pose X_RG with the information (6, 6) of its error in the sense of `edge_motion.pose_error`. Where it is
unobservable it has no information, rather than a large variance: the update is made in its observable
directions, in Joseph's form (Bucy and Joseph, "Filtering for stochastic processes with applications to
guidance", 1968). After it the attitude's error is reset (Sola, "Quaternion kinematics for the error-state
Kalman filter", 2017, section 6.3).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2

from polhode.compiled import compiled_ieee
from polhode.lie import (
    Array,
    exp_so3,
    hat,
    inverse_pose,
    log_so3,
    make_pose,
    matrix_from_wxyz,
    right_jacobian_so3,
)
from polhode.planning.edges.observability_metric import motion_scale, pose_error

MAX_STEP_ANGLE_RAD = 0.03
"""Of the body in one step of the integration."""


def propagate_rotation(
    moments: Array, w_P: Array, dt_s: float, torque_psd: float
) -> tuple[Array, Array, Array, Array]:
    """From the rate w_P (3,) [rad/s], for dt_s [s], in the principal axes with moments (3,), middle one 1.

    Returns the turn (3, 3), R_NP = R_NP before @ turn; the rate (3,); Phi (6, 6), by which errors of theta
    and w grow; Q (6, 6), the covariance of what white torque adds: torque_psd [(rad/s^2)^2/Hz], over the
    middle moment. theta' = -w x theta + dw;  dw' = J^-1 ((J w) x - w x J) dw.
    """
    steps = max(1, int(np.ceil(dt_s * float(np.linalg.norm(w_P)) / MAX_STEP_ANGLE_RAD)))
    y = np.zeros(79)
    y[0], y[4:7], y[7:43] = 1.0, w_P, np.eye(6).ravel()
    _integrate(np.ascontiguousarray(moments), y, dt_s / steps, steps, torque_psd)
    turn = matrix_from_wxyz(y[:4] / np.linalg.norm(y[:4]))
    return turn, y[4:7], y[7:43].reshape(6, 6), y[43:].reshape(6, 6)


@compiled_ieee
def _integrate(moments: Array, y: Array, h: float, steps: int, psd: float) -> None:
    """Carry y (79,) on in place: quaternion, rate, Phi and Q by rows."""
    slope, total = np.empty(79), np.empty(79)
    for _ in range(steps):
        _derivative(moments, y, psd, slope)
        total[:] = slope
        _derivative(moments, y + 0.5 * h * slope, psd, slope)
        total += 2.0 * slope
        _derivative(moments, y + 0.5 * h * slope, psd, slope)
        total += 2.0 * slope
        _derivative(moments, y + h * slope, psd, slope)
        total += slope
        y += h / 6.0 * total


@compiled_ieee
def _derivative(moments: Array, y: Array, psd: float, out: Array) -> None:
    """Derivative (79,) of y in time."""
    a, b, c = y[4], y[5], y[6]
    out[0] = 0.5 * (-y[1] * a - y[2] * b - y[3] * c)
    out[1] = 0.5 * (y[0] * a + y[2] * c - y[3] * b)
    out[2] = 0.5 * (y[0] * b + y[3] * a - y[1] * c)
    out[3] = 0.5 * (y[0] * c + y[1] * b - y[2] * a)
    A = np.zeros((6, 6))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        share = (moments[j] - moments[k]) / moments[i]
        out[4 + i] = share * y[4 + j] * y[4 + k]
        A[i, j], A[i, k], A[i, 3 + i] = y[4 + k], -y[4 + j], 1.0
        A[3 + i, 3 + j], A[3 + i, 3 + k] = share * y[4 + k], share * y[4 + j]
    for i in range(6):
        for j in range(6):
            grown, added = 0.0, 0.0
            for k in range(6):
                grown += A[i, k] * y[7 + 6 * k + j]
                added += A[i, k] * y[43 + 6 * k + j] + A[j, k] * y[43 + 6 * k + i]
            out[7 + 6 * i + j] = grown
            out[43 + 6 * i + j] = added
    for i in range(3):
        out[43 + 6 * (3 + i) + 3 + i] += psd / moments[i] ** 2


UNOBSERVABLE_SHARE = 1e-9
"""Share of the largest information, translations in radii, below which a direction is unobservable."""


@dataclass(frozen=True)
class Target:
    """What is known of the body, and of what disturbs it."""

    moments: Array
    """(3,) principal moments of inertia, middle one 1"""
    X_GP: Array
    """(4, 4) its principal axes and centre of mass in the model's frame"""
    o_G: Array
    """(3,) reference point of the errors of measured poses [m]"""
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
    directions: int
    """observable ones of the measurement: the expectation of nis"""
    taken: bool
    """False: refused by the gate"""


def predict(state: State, target: Target, dt_s: float, accel_N: Array) -> State:
    """The state after dt_s > 0 [s] of free motion; accel_N (3,) of the inspector in this time [m/s^2]."""
    turn, w_P, Phi, Q = propagate_rotation(target.moments, state.w_P, dt_s, target.torque_psd)
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


def observable_directions(information: Array, radius_m: float) -> tuple[Array, Array]:
    """Observable directions D (k, 6) of information (6, 6), and variances (k,) of D @ error, uncorrelated."""
    scale = motion_scale(radius_m)
    values, directions = np.linalg.eigh(information * np.outer(scale, scale))
    observable = values > max(UNOBSERVABLE_SHARE * float(values[-1]), 0.0)
    # scaled information V L V^T: V^T (error / scale) has variances 1 / L
    return np.asarray(directions[:, observable].T / scale), 1.0 / values[observable]


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
    D, variance = observable_directions(information, target.radius_m)
    count = len(variance)
    if count == 0:
        return Update(state, 0.0, 0, False)
    innovation = D @ pose_error(X_RG, predicted_pose(state, target, R_NR), target.o_G)
    H = D @ measurement_jacobian(state, target, R_NR)
    P = state.covariance
    S = cho_factor(H @ P @ H.T + np.diag(variance))
    nis = float(innovation @ cho_solve(S, innovation))
    if gate is not None and nis > float(chi2.ppf(gate, count)):
        return Update(state, nis, count, False)
    K = cho_solve(S, H @ P).T
    error = K @ innovation
    rest = np.eye(12) - K @ H
    P = rest @ P @ rest.T + (K * variance) @ K.T
    reset = np.eye(12)
    reset[6:9, 6:9] = right_jacobian_so3(error[6:9])
    P = reset @ P @ reset.T
    moved = state.plus(error)
    return Update(State(moved.r_N, moved.v_N, moved.R_NP, moved.w_P, 0.5 * (P + P.T)), nis, count, True)
