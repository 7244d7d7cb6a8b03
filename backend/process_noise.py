"""Covariance of the process noise over one step, from the Lyapunov equation (thesis eqs. 4.56-4.59).

Continuous white acceleration and torque; error state (r, v) in N and (theta, w) in G with the attitude
error on the right. The equation is integrated along the motion itself, in scaled variables
(theta by dt^1.5, w by dt^0.5), so that the matrix is well conditioned for any time step (section 4.9).
"""

import numpy as np

from polhode.lie import Array, hat
from polhode.records import Ints

SUBSTEP_RAD = 0.1
"""Largest rotation in one Runge-Kutta step: keeps the integrator's error far below the process noise."""
MAX_SUBSTEPS = 64


def substeps(rate_rad_s: Array, dt_s: Array) -> Ints:
    """Runge-Kutta steps for each interval (n,), a power of two so that few programs are needed."""
    needed = np.maximum(np.asarray(rate_rad_s) * np.asarray(dt_s) / SUBSTEP_RAD, 1.0)
    return np.asarray(np.minimum(2 ** np.ceil(np.log2(needed)), MAX_SUBSTEPS), dtype=np.int64)


def translation_covariance(dt_s: Array, accel_psd: float) -> Array:
    """Covariance (n, 2, 2) of (r, v) along one axis: q [dt^3/3, dt^2/2; dt^2/2, dt]."""
    t = np.asarray(dt_s, dtype=np.float64)
    return accel_psd * np.stack([np.stack([t**3 / 3, t**2 / 2], -1), np.stack([t**2 / 2, t], -1)], -2)


def rotation_covariance_scaled(w_G: Array, J_G: Array, dt_s: Array, torque_psd: float) -> tuple[Array, Array]:
    """Covariance (n, 6, 6) of (theta, w) divided by the scale (n, 6): Lambda = S Lambda_scaled S.

    w_G (n, 3) rate at the start [rad/s], J_G (3, 3) any scale, dt_s (n,), torque_psd [(rad/s^2)^2/Hz] over
    the middle moment.
    """
    n, t = len(dt_s), np.asarray(dt_s, dtype=np.float64)
    J = J_G / np.linalg.eigvalsh(J_G)[1]
    J_inv = np.linalg.inv(J)
    steps = int(substeps(np.linalg.norm(w_G, axis=1), t).max()) * 2
    scale = np.sqrt(torque_psd) * np.concatenate(
        [np.repeat(t[:, None] ** 1.5, 3, 1), np.repeat(t[:, None] ** 0.5, 3, 1)], 1
    )
    noise = np.zeros((n, 6, 6))
    noise[:, 3:, 3:] = J_inv @ J_inv.T

    def derivative(w: Array, cov: Array) -> tuple[Array, Array]:
        # time runs from 0 to 1 over the step, hence the factors of t
        w_dot = -np.cross(w, w @ J) @ J_inv * t[:, None]
        A = np.zeros((n, 6, 6))
        A[:, :3, :3] = -hat(w) * t[:, None, None]
        A[:, :3, 3:] = np.eye(3)
        A[:, 3:, 3:] = J_inv @ (hat(w @ J) - hat(w) @ J) * t[:, None, None]
        flow = A @ cov
        return w_dot, flow + np.swapaxes(flow, 1, 2) + noise

    w, cov, h = np.array(w_G, dtype=np.float64), np.zeros((n, 6, 6)), 1.0 / steps
    for _ in range(steps):
        a1, c1 = derivative(w, cov)
        a2, c2 = derivative(w + 0.5 * h * a1, cov + 0.5 * h * c1)
        a3, c3 = derivative(w + 0.5 * h * a2, cov + 0.5 * h * c2)
        a4, c4 = derivative(w + h * a3, cov + h * c3)
        w = w + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        cov = cov + h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
    return cov, scale


def rotation_covariance(w_G: Array, J_G: Array, dt_s: Array, torque_psd: float) -> Array:
    """Covariance (n, 6, 6) of (theta, w) after one step [rad^2, rad^2/s, rad^2/s^2]."""
    cov, scale = rotation_covariance_scaled(w_G, J_G, dt_s, torque_psd)
    return cov * scale[:, :, None] * scale[:, None, :]


def whitening(
    w_G: Array,
    J_G: Array,
    dt_s: Array,
    accel_psd: float,
    torque_psd: float,
    pose_variance: tuple[float, float] = (0.0, 0.0),
) -> tuple[Array, Array, float]:
    """Square roots of the information: translation (n, 2, 2), rotation (n, 6, 6), lower triangular.

    ``W @ error`` has unit covariance. Third: half the log-determinant of all covariances, which makes the
    costs of different inertias comparable. ``pose_variance`` [m^2, rad^2] of each pose, by the noise of the
    camera's own, enters every step twice: as if the steps were independent, which is on the safe side.
    """
    translation = translation_covariance(dt_s, accel_psd)
    translation[:, 0, 0] += 2.0 * pose_variance[0]
    T = np.linalg.cholesky(translation)
    cov, scale = rotation_covariance_scaled(w_G, J_G, dt_s, torque_psd)
    cov[:, [0, 1, 2], [0, 1, 2]] += 2.0 * pose_variance[1] / scale[:, :3] ** 2
    L = np.linalg.cholesky(cov)
    half_log = float(np.log(np.diagonal(L, axis1=1, axis2=2)).sum() + np.log(scale).sum())
    half_log += 3.0 * float(np.log(np.diagonal(T, axis1=1, axis2=2)).sum())
    return np.linalg.inv(T), np.linalg.inv(L) / scale[:, None, :], half_log
