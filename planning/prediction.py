"""Where the target will be: the last state carried on as a free rigid body, with its covariance.

The mean follows ``polhode.rigid_body.propagate``; the covariance follows the linearised flow (variational
equations of Newton and Euler) with white acceleration and torque (thesis eqs. 4.56-4.59). Only the principal
moments enter, so inertia and axes in G need not be known.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from polhode.lie import Array, hat
from polhode.rigid_body import propagate

N_STATE = 12
_NEGLIGIBLE = 1e-9
"""Sensitivity, in units of state per unit of state, below which an undetermined input does not matter."""


@dataclass(frozen=True)
class LastState:
    """The end of a run."""

    r_N: Array
    """(3,) [m]"""
    v_N: Array
    """(3,) [m/s]"""
    R_NP: Array
    """(3, 3)"""
    w_P: Array
    """(3,) [rad/s]"""
    moments: Array
    """(3,) principal moments, middle one 1"""
    covariance: Array
    """(12 + k, 12 + k): r (N), v (N), theta (P), w (P), then k parameters of the inertia; ``inf`` on the
    diagonal where undetermined"""
    moments_by_parameters: Array
    """(3, k) derivative of the moments by those parameters; k = 0: the moments are exact"""


@dataclass(frozen=True)
class Prediction:
    """States at T instants after the last one."""

    time_s: Array
    """(T,) since the last state"""
    r_N: Array
    """(T, 3) [m]"""
    v_N: Array
    """(T, 3) [m/s]"""
    R_NP: Array
    """(T, 3, 3)"""
    w_P: Array
    """(T, 3) [rad/s]"""
    covariance: Array
    """(T, 12, 12) r (N), v (N), theta (P), w (P); ``inf`` on the diagonal where undetermined"""


def predict(last: LastState, time_s: ArrayLike, accel_psd: float, torque_psd: float) -> Prediction:
    """Propagate to time_s (T,), increasing, >= 0 [s] after the last state.

    accel_psd [(m/s^2)^2/Hz]; torque_psd [(rad/s^2)^2/Hz], torque over the middle moment.
    """
    time = np.asarray(time_s, dtype=np.float64)
    grid = np.concatenate([[0.0], time])
    first = 1 if len(time) and time[0] > 0.0 else 0
    grid = grid if first else time
    r_N, v_N, R_NP, w_P = propagate(grid, last.r_N, last.v_N, last.R_NP, last.w_P, np.diag(last.moments))
    flow, noise = _rotation_flow(last, time, torque_psd)
    covariance = np.stack(
        [_covariance(last, t, F, Q, accel_psd) for t, F, Q in zip(time, flow, noise, strict=True)]
    )
    return Prediction(time, r_N[first:], v_N[first:], R_NP[first:], w_P[first:], covariance)


def _rotation_flow(last: LastState, time: Array, torque_psd: float) -> tuple[Array, Array]:
    """Derivative of (theta, w) at each time by (theta, w, moments) at the start (T, 6, 9); noise (T, 6, 6).

    theta' = -w x theta + dw;  dw' = J^-1 ((J w) x - w x J) dw + (dw'/dJ) dJ, J diagonal.
    """
    J = last.moments

    def derivative(_: float, y: Array) -> Array:
        w, F, Q = y[:3], y[3:57].reshape(6, 9), y[57:].reshape(6, 6)
        A = np.zeros((6, 6))
        A[:3, :3], A[:3, 3:] = -hat(w), np.eye(3)
        A[3:, 3:] = (hat(J * w) - hat(w) * J) / J[:, None]
        F_dot = A @ F
        F_dot[3:, 6:] += _acceleration_by_moments(J, w)
        Q_dot = A @ Q + Q @ A.T
        Q_dot[3:, 3:] += torque_psd * np.diag(1.0 / J**2)
        w_dot = np.cross(J * w, w) / J
        return np.concatenate([w_dot, F_dot.ravel(), Q_dot.ravel()])

    start = np.concatenate([last.w_P, np.eye(6, 9).ravel(), np.zeros(36)])
    end = float(time[-1]) if len(time) else 0.0
    if end <= 0.0:
        states = np.tile(start, (len(time), 1))
    else:
        answer = solve_ivp(derivative, (0.0, end), start, "DOP853", t_eval=time, rtol=1e-8, atol=1e-12)
        if not answer.success:
            raise FloatingPointError(f"the prediction's covariance could not be integrated: {answer.message}")
        states = answer.y.T
    return states[:, 3:57].reshape(-1, 6, 9), states[:, 57:].reshape(-1, 6, 6)


def _acceleration_by_moments(J: Array, w: Array) -> Array:
    """d w' / d (J1, J2, J3) (3, 3): w'_1 = (J2 - J3) / J1 w2 w3 and cyclic."""
    out = np.zeros((3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        product = w[j] * w[k] / J[i]
        out[i, i], out[i, j], out[i, k] = -(J[j] - J[k]) / J[i] * product, product, -product
    return out


def _covariance(last: LastState, t: float, rotation: Array, noise: Array, accel_psd: float) -> Array:
    """(12, 12) at time t [s]."""
    n = len(last.covariance)
    flow = np.zeros((N_STATE, n))
    flow[:6, :6] = np.eye(6)
    flow[:3, 3:6] = t * np.eye(3)
    flow[6:, 6:12] = rotation[:, :6]
    flow[6:, 12:] = rotation[:, 6:] @ last.moments_by_parameters
    unknown = ~np.isfinite(np.diagonal(last.covariance))
    known = np.where(unknown[:, None] | unknown[None, :], 0.0, last.covariance)
    out = np.asarray(flow @ known @ flow.T)
    out[6:, 6:] += noise
    eye = np.eye(3)
    out[:3, :3] += accel_psd * t**3 / 3 * eye
    out[:3, 3:6] += accel_psd * t**2 / 2 * eye
    out[3:6, :3] += accel_psd * t**2 / 2 * eye
    out[3:6, 3:6] += accel_psd * t * eye
    lost = (np.abs(flow[:, unknown]) > _NEGLIGIBLE).any(axis=1)
    out[lost, :], out[:, lost] = 0.0, 0.0
    out[lost, lost] = np.inf
    return out
