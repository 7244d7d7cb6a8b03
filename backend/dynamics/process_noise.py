"""Covariance of the process noise over one step, from the Lyapunov equation (thesis eqs. 4.56-4.59).

The disturbances are continuous white acceleration and torque; the error state is (r, v) in N and (theta, w)
in G with the attitude error on the right. The equation is integrated along the motion, in scaled variables
(theta by dt^1.5, w by dt^0.5), so that the matrix is well conditioned for any time step (section 4.9).
"""

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.dynamics.propagation import propagate_derivatives, propagate_rotations
from polhode.geometry.lie import Array, matrix_from_wxyz

PART_RAD = 0.7
"""Largest rotation in a part of an interval: the variances are accurate to 1e-4."""


def translation_covariance(dt_s: Array, accel_psd: float | Array) -> Array:
    """Covariance (n, 2, 2) of (r, v) along one axis: q [dt^3/3, dt^2/2; dt^2/2, dt]; q may differ by step."""
    t = np.asarray(dt_s, dtype=np.float64)
    unit = np.stack([np.stack([t**3 / 3, t**2 / 2], -1), np.stack([t**2 / 2, t], -1)], -2)
    return np.asarray(np.broadcast_to(accel_psd, t.shape)[:, None, None] * unit)


def rotation_covariance_scaled(
    w_G: Array, J_G: Array, dt_s: Array, torque_psd: float | Array
) -> tuple[Array, Array]:
    """Covariance (n, 6, 6) of (theta, w) divided by the scale (n, 6): Lambda = S Lambda_scaled S.

    w_G (n, 3) rate at the start [rad/s], J_G (3, 3) any scale, dt_s (n,), torque_psd [(rad/s^2)^2/Hz] over
    the middle moment, one or (n,).
    """
    t = np.asarray(dt_s, dtype=np.float64)
    J = np.ascontiguousarray(J_G / np.linalg.eigvalsh(J_G)[1])
    w = np.ascontiguousarray(w_G, dtype=np.float64)
    root = np.broadcast_to(np.sqrt(torque_psd), t.shape)[:, None]
    scale = root * np.repeat(np.stack([t**1.5, t**0.5], 1), 3, axis=1)
    return _integrated(w, J, t), scale


def _integrated(w_G: Array, J_G: Array, dt_s: Array) -> Array:
    """Covariances (n, 6, 6) in theta / dt^1.5, w / dt^0.5 for a torque of unit strength."""
    n = len(dt_s)
    # only a solution that diverges has larger ones; this rejects NaN too
    if not np.all(np.linalg.norm(w_G, axis=1) * dt_s < 1e4):
        raise LinAlgError("a rate beyond all bounds")
    cov, w, done = np.zeros((n, 6, 6)), w_G.copy(), np.zeros(n)
    left = np.arange(n)
    abscissas, weights = np.polynomial.legendre.leggauss(3)
    while len(left):
        t, at, one = dt_s[left], w[left], np.ones(len(left), dtype=np.int64)
        rest = 1.0 - done[left]
        part = rest / np.maximum(1.0, np.ceil(rest * t * np.linalg.norm(at, axis=1) / PART_RAD))
        F, w[left] = _transition(at, J_G, t, part)
        cov[left] = F @ cov[left] @ np.swapaxes(F, 1, 2)
        for node, weight in zip(0.5 * (abscissas + 1.0), 0.5 * weights, strict=True):
            between = propagate_rotations(at, J_G, t * part * node, one)[1]
            K = _transition(between, J_G, t, part * (1.0 - node))[0][:, :, 3:] @ np.linalg.inv(J_G)
            cov[left] += weight * part[:, None, None] * (K @ np.swapaxes(K, 1, 2))
        done[left] += part
        left = left[done[left] < 1.0 - 1e-12]
    return 0.5 * (cov + np.swapaxes(cov, 1, 2))


def _transition(w_G: Array, J_G: Array, t: Array, part: Array) -> tuple[Array, Array]:
    """Transition (n, 6, 6) of (theta / t, w) over a part (n,) of t (n,) seconds, and the rate after it."""
    q, w_end, turn, rate = propagate_derivatives(
        w_G, J_G, np.zeros((0, 3, 3)), t * part, np.ones(len(t), dtype=np.int64)
    )
    # a series that diverges gives no unit quaternion, or NaN
    if not np.all(np.abs(np.linalg.norm(q, axis=1) - 1.0) < 1e-6):
        raise LinAlgError("a rate beyond all bounds")
    F = np.zeros((len(t), 6, 6))
    F[:, :3, :3] = np.swapaxes(matrix_from_wxyz(q), 1, 2)
    F[:, :3, 3:] = np.swapaxes(turn, 1, 2) / t[:, None, None]
    F[:, 3:, 3:] = np.swapaxes(rate, 1, 2)
    return F, w_end


def whitening(
    w_G: Array,
    J_G: Array,
    dt_s: Array,
    accel_psd: float | Array,
    torque_psd: float | Array,
    of_length: tuple[Array, Array] | None = None,
) -> tuple[Array, Array, float]:
    """Square roots of the information: translation (n, 2, 2), rotation (n, 6, 6), lower triangular.

    ``W @ error`` has unit covariance. Third: half the log-determinant of all covariances, which makes the
    costs of different inertias comparable. of_length: what an uncertain length of the steps adds, the
    variance (n,) of the position along each axis and the error (n, 6) of attitude and rate for one sigma.
    """
    of_centre = translation_covariance(dt_s, accel_psd)
    cov, scale = rotation_covariance_scaled(w_G, J_G, dt_s, torque_psd)
    if of_length is not None:
        of_centre[:, 0, 0] += of_length[0]
        turn = of_length[1] / scale
        cov += turn[:, :, None] * turn[:, None, :]
    T = np.linalg.cholesky(of_centre)
    L = np.linalg.cholesky(cov)
    half_log = float(np.log(np.diagonal(L, axis1=1, axis2=2)).sum() + np.log(scale).sum())
    half_log += 3.0 * float(np.log(np.diagonal(T, axis1=1, axis2=2)).sum())
    return np.linalg.inv(T), np.linalg.inv(L) / scale[:, None, :], half_log
