"""Covariance of the process noise over one step, from the Lyapunov equation (thesis eqs. 4.56-4.59).

The disturbances are continuous white acceleration and torque; the error state is (r, v) in N and (theta, w)
in G with the attitude error on the right. The equation is integrated along the motion, in scaled variables
(theta by dt^1.5, w by dt^0.5), so that the matrix is well conditioned for any time step (section 4.9).
"""

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.linalg import LinAlgError

from polhode.backend.dynamics.propagation import flow_derivatives, flows
from polhode.geometry.lie import Array
from polhode.runtime.compiled import compiled

PART_RAD = 0.7
"""Largest rotation in a part of an interval: the variances are accurate to 1e-4."""
ABSCISSAS, WEIGHTS = 0.5 * (leggauss(3)[0] + 1.0), 0.5 * leggauss(3)[1]
"""Of Gauss's and Legendre's quadrature from 0 to 1"""


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
    # only a solution that diverges has larger ones; this rejects NaN too
    if not np.all(np.linalg.norm(w_G, axis=1) * dt_s < 1e4):
        raise LinAlgError("a rate beyond all bounds")
    J_inv = np.asarray(np.linalg.inv(J_G), dtype=np.float64)
    cov = np.zeros((len(dt_s), 6, 6))
    if not _integrate(w_G, J_G, J_inv, dt_s, cov):
        raise LinAlgError("a rate beyond all bounds")
    return 0.5 * (cov + np.swapaxes(cov, 1, 2))


@compiled
def _integrate(w_G: Array, J: Array, J_inv: Array, dt_s: Array, cov: Array) -> bool:
    """Fill the covariances (n, 6, 6), which are 0 before; whether all series converge."""
    F, K, strength = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 3))
    for n in range(len(dt_s)):
        w, t, done = w_G[n : n + 1].copy(), dt_s[n], 0.0
        while done < 1.0 - 1e-12:
            rest, rate = 1.0 - done, np.sqrt(np.sum(w**2))
            part = rest / max(1.0, np.ceil(rest * t * rate / PART_RAD))
            after = _transition(w, J, J_inv, t, part, F)
            if len(after) == 0:
                return False
            cov[n] = F @ cov[n] @ F.T
            for node in range(len(ABSCISSAS)):
                at = np.array([t * part * ABSCISSAS[node]])
                between = flows(w, J, J_inv, at, np.zeros((1, 0, 2, 3)), np.ones(1, dtype=np.int64))[1]
                if len(_transition(between, J, J_inv, t, part * (1.0 - ABSCISSAS[node]), K)) == 0:
                    return False
                strength[:] = np.ascontiguousarray(K[:, 3:]) @ J_inv
                cov[n] += WEIGHTS[node] * part * (strength @ strength.T)
            w = after
            done += part
    return True


@compiled
def _transition(w_G: Array, J: Array, J_inv: Array, t: float, part: float, F: Array) -> Array:
    """Fill the transition (6, 6) of (theta / t, w) over a part of t seconds; the rate (1, 3) after it.

    Empty where the series diverges: it gives no unit quaternion, or NaN.
    """
    once, none, unknown = np.ones(1, dtype=np.int64), np.zeros((1, 0, 2, 3)), np.zeros((1, 0, 3, 2, 3))
    of_inertia, seconds = np.zeros((3, 3, 3)), np.array([t * part])
    q, w_end, turn, rate = flow_derivatives(w_G, J, J_inv, of_inertia, seconds, none, unknown, once)
    a, b, c, d = q[0]
    if not abs(np.sqrt(a * a + b * b + c * c + d * d) - 1.0) < 1e-6:
        return w_end[:0]
    # the rotation back
    F[0, 0], F[0, 1], F[0, 2] = 1.0 - 2.0 * (c * c + d * d), 2.0 * (b * c + a * d), 2.0 * (b * d - a * c)
    F[1, 0], F[1, 1], F[1, 2] = 2.0 * (b * c - a * d), 1.0 - 2.0 * (b * b + d * d), 2.0 * (c * d + a * b)
    F[2, 0], F[2, 1], F[2, 2] = 2.0 * (b * d + a * c), 2.0 * (c * d - a * b), 1.0 - 2.0 * (b * b + c * c)
    F[:3, 3:] = turn[0].T / t
    F[3:, 3:] = rate[0].T
    return w_end


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
