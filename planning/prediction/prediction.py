"""Where the target will be: the last state carried on as a free rigid body, with its covariance.

A flip multiplies small errors, and an undetermined inertia is known only as far as the motion showed it: a
linearised covariance fails there. So the last state and the inertia are drawn from their joint covariance, in
pairs of opposite deviations whose second moments are exactly those of the covariance: while errors stay small
the answer is the linear one. Each member moves as a free rigid body of its own inertia. White disturbances
are added by their linearised flow (thesis eqs. 4.56-4.59).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from polhode.lie import Array, exp_so3, hat, log_so3, matrix_from_wxyz, wxyz_from_matrix
from polhode.rigid_body import propagate

PAIRS = 128
UNKNOWN_RAD = float(np.sqrt((np.pi**2 / 3.0 + 2.0) / 3.0))
"""Root mean square of each component of the rotation vector of a random attitude, all equally likely."""
MIN_SECOND_MOMENT = 0.02
"""Of the largest: a drawn inertia is pulled towards the estimate until it is a possible body."""


@dataclass(frozen=True)
class FinalState:
    """The end of a run, the body itself: nothing is expressed in the principal axes."""

    r_N: Array
    """(3,) centre of mass [m]"""
    v_N: Array
    """(3,) [m/s]"""
    R_NG: Array
    """(3, 3)"""
    w_G: Array
    """(3,) [rad/s]"""
    J_G: Array
    """(3, 3) inertia, any scale"""
    R_GP: Array
    """(3, 3) its principal axes"""
    J_jacobian: Array
    """(5, 3, 3) derivative of J_G by the five parameters of the inertia"""
    covariance: Array
    """(20, 20): r_N, v_N, theta in R_NG Exp(theta), w_G, the five parameters, com_G; finite"""
    past_s: Array | None = None
    """(H,) instants < 0 before the last one, descending: what an undetermined inertia is held against"""
    past_R_NG: Array | None = None
    """(H, 3, 3) attitudes there"""


@dataclass(frozen=True)
class Prediction:
    """States at T instants, with two covariances (T, 12, 12) of r (N), v (N), theta (P), w (P)."""

    time_s: Array
    """(T,) since the last state"""
    r_N: Array
    v_N: Array
    R_NP: Array
    w_P: Array
    covariance: Array
    """of the centre of mass and the principal axes: large where those are hardly known"""
    covariance_of_marks: Array
    """of the body: the estimated centre of mass and axes are marks on it, and exact"""


def predict(last: FinalState, time_s: ArrayLike, accel_psd: float, torque_psd: float) -> Prediction:
    """Propagate to time_s (T,), increasing, >= 0 [s] after the last state.

    accel_psd [(m/s^2)^2/Hz]; torque_psd [(rad/s^2)^2/Hz], torque over the middle moment.
    """
    time = np.asarray(time_s, dtype=np.float64)
    grid = time if time[0] == 0.0 else np.concatenate([[0.0], time])
    states = propagate(grid, last.r_N, last.v_N, last.R_NG, last.w_G, last.J_G)
    r_N, v_N, R_NG, w_G = (each[len(grid) - len(time) :] for each in states)
    deviation, J = draw_deviations(last)
    R, w = propagate_members(last, deviation, J, time)
    moments = np.diag(last.R_GP.T @ last.J_G @ last.R_GP)
    noise = process_noise(moments / moments[1], last.w_G @ last.R_GP, time, accel_psd, torque_psd)
    dr = deviation[:, 0:3] + time[:, None, None] * deviation[:, 3:6]
    dv = np.broadcast_to(deviation[:, 3:6], dr.shape)

    # how each member's principal axes lie against the estimated ones
    turn = exp_so3(deviation[:, 12:17] @ axes_jacobian(last).T)
    R_NP, R_GP = R_NG @ last.R_GP, last.R_GP
    back = np.swapaxes(R_NP, 1, 2)[:, None]
    theta = log_so3(back @ R @ R_GP @ turn)
    dw = np.einsum("nji,tnj->tni", R_GP @ turn, w) - (w_G @ R_GP)[:, None]
    of_axes = _no_worse_than_unknown(_second_moments(dr, dv, theta, dw) + noise)

    com = deviation[:, 17:20]
    lever = np.einsum("tnij,nj->tni", R, com)
    swing = np.einsum("tnij,tnj->tni", R, np.cross(w, com))
    theta, dw = log_so3(back @ R @ R_GP), (w - w_G[:, None]) @ R_GP
    of_marks = _no_worse_than_unknown(_second_moments(dr - lever, dv - swing, theta, dw) + noise)
    return Prediction(time, r_N, v_N, R_NP, w_G @ R_GP, of_axes, of_marks)


def draw_deviations(last: FinalState, normal: Array | None = None) -> tuple[Array, Array]:
    """Deviations (n, 20) from the last state, and the inertias (n, 3, 3) that go with them.

    ``normal`` (n, 20): independent standard normal numbers. Without: 2 PAIRS whose moments are exact.
    """
    sigma = np.sqrt(np.diag(last.covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(last.covariance / scale[:, None] / scale)
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    if normal is None:
        z = np.random.default_rng([0, 60]).normal(size=(PAIRS, len(root)))
        z = z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / PAIRS)).T
        normal = np.concatenate([z, -z])
    deviation = normal @ root.T
    # linear in the parameters: what the motion forbids stays so, such as a spin about no principal axis
    change = np.einsum("nk,kij->nij", deviation[:, 12:17], last.J_jacobian)
    share = _largest_share(last.J_G, change)
    deviation[:, 12:17] *= share[:, None]
    change *= share[:, None, None]
    if last.past_s is not None and last.past_R_NG is not None:
        share = _share_consistent_with_past(last, deviation, change, last.past_s, last.past_R_NG)
        deviation[:, 12:17] *= share[:, None]
        change *= share[:, None, None]
    return deviation, last.J_G + change


def _largest_share(J: Array, change: Array) -> Array:
    """Shares (N,) of the changes (N, 3, 3), halved until J + share change is a possible body."""
    share = np.ones(len(change))
    for _ in range(12):
        moved = J + share[:, None, None] * change
        values = np.linalg.eigvalsh(
            0.5 * np.trace(moved, axis1=1, axis2=2)[:, None, None] * np.eye(3) - moved
        )
        bad = values[:, 0] < MIN_SECOND_MOMENT * values[:, 2]
        if not bad.any():
            break
        share[bad] *= 0.5
    return share


def _share_consistent_with_past(
    last: FinalState, deviation: Array, change: Array, past_s: Array, past_R_NG: Array
) -> Array:
    """Shares (N,) of the changes of J, halved until the member's past is the one that was seen.

    A linear covariance lets through bodies whose spin would have tipped over long ago. A past may differ from
    the one seen twice as much as the estimate's own, and by three standard deviations of attitude and rate.
    """

    def past(members: Array, J: Array) -> Array:
        R, _ = propagate_members(last, members, J, past_s)
        return np.asarray(np.linalg.norm(log_so3(np.swapaxes(R, -1, -2) @ past_R_NG[:, None]), axis=-1))

    own = past(np.zeros((1, 20)), last.J_G[None])[:, 0]
    variance = np.diag(last.covariance)
    free = variance[6:9].sum() + variance[9:12].sum() * past_s**2
    limit = np.sqrt(4.0 * own**2 + 9.0 * free)
    share = np.ones(len(change))
    for factor in (1.0, 0.5, 0.25, 0.125, 0.0625):
        open_ = np.flatnonzero(share == factor)
        if len(open_) == 0:
            break
        off = past(deviation[open_], last.J_G + factor * change[open_])
        share[open_[(off > limit[:, None]).any(axis=0)]] = 0.5 * factor
    return share


def axes_jacobian(last: FinalState) -> Array:
    """Derivative (3, 5) of theta in R_GP Exp(theta); of equal moments it has no meaning, and is zero."""
    changes = last.R_GP.T @ last.J_jacobian @ last.R_GP
    values = np.diag(last.R_GP.T @ last.J_G @ last.R_GP)
    gaps = np.array([values[1] - values[2], values[2] - values[0], values[0] - values[1]])
    turns = np.stack([changes[:, 2, 1], changes[:, 0, 2], changes[:, 1, 0]])
    known = np.abs(gaps) > 1e-9 * values[1]
    return np.where(known, 1.0, 0.0)[:, None] * turns / np.where(known, gaps, 1.0)[:, None]


def propagate_members(last: FinalState, deviation: Array, J: Array, time: Array) -> tuple[Array, Array]:
    """Attitudes (T, N, 3, 3) and rates (T, N, 3) in G of all members."""
    n = len(deviation)
    q = wxyz_from_matrix(last.R_NG @ exp_so3(deviation[:, 6:9]))
    start = np.concatenate([q.T, (last.w_G + deviation[:, 9:12]).T]).ravel()
    J_inv = np.linalg.inv(J)

    def derivative(_: float, y: Array) -> Array:
        q0, q1, q2, q3, a, b, c = y.reshape(7, n)
        w = np.stack([a, b, c], axis=1)
        h = np.einsum("nij,nj->ni", J, w)
        w_dot = np.einsum("nij,nj->ni", J_inv, np.cross(h, w))
        q_dot = 0.5 * np.stack(
            [
                -q1 * a - q2 * b - q3 * c,
                q0 * a + q2 * c - q3 * b,
                q0 * b + q3 * a - q1 * c,
                q0 * c + q1 * b - q2 * a,
            ]
        )
        return np.concatenate([q_dot, w_dot.T]).ravel()

    states = _integrate(derivative, start, time)
    parts = np.moveaxis(states.reshape(len(time), 7, n), 1, 2)
    q = parts[..., :4] / np.linalg.norm(parts[..., :4], axis=-1, keepdims=True)
    return matrix_from_wxyz(q), parts[..., 4:]


def _second_moments(*deviations: Array) -> Array:
    """Mean square (T, 12, 12) of four deviations (T, N, 3) about the prediction itself."""
    d = np.concatenate(deviations, axis=-1)
    return np.asarray(np.swapaxes(d, 1, 2) @ d / d.shape[1])


def _no_worse_than_unknown(covariance: Array) -> Array:
    """(T, 12, 12), the attitude's standard deviations at most those of one of which nothing is known."""
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, 6:9])
    factor = np.ones(covariance.shape[:2])
    factor[:, 6:9] = UNKNOWN_RAD / np.maximum(sigma, UNKNOWN_RAD)
    return np.asarray(factor[:, :, None] * covariance * factor[:, None, :])


def process_noise(moments: Array, w_P: Array, time_s: Array, accel_psd: float, torque_psd: float) -> Array:
    """What white disturbances add to the covariance (T, 12, 12) of r (N), v (N), theta (P), w (P).

    moments (3,), middle one 1; w_P (3,) [rad/s] at the start; time_s (T,) >= 0 [s], increasing.
    theta' = -w x theta + dw;  dw' = J^-1 ((J w) x - w x J) dw.
    """

    def derivative(_: float, y: Array) -> Array:
        w, Q = y[:3], y[3:].reshape(6, 6)
        A = np.zeros((6, 6))
        A[:3, :3], A[:3, 3:] = -hat(w), np.eye(3)
        A[3:, 3:] = (hat(moments * w) - hat(w) * moments) / moments[:, None]
        Q_dot = A @ Q + Q @ A.T
        Q_dot[3:, 3:] += torque_psd * np.diag(1.0 / moments**2)
        return np.concatenate([np.cross(moments * w, w) / moments, Q_dot.ravel()])

    states = _integrate(derivative, np.concatenate([w_P, np.zeros(36)]), time_s)
    out, i = np.zeros((len(time_s), 12, 12)), np.arange(3)
    out[:, 6:, 6:] = states[:, 3:].reshape(-1, 6, 6)
    out[:, i, i] = accel_psd * time_s[:, None] ** 3 / 3
    out[:, i, i + 3] = out[:, i + 3, i] = accel_psd * time_s[:, None] ** 2 / 2
    out[:, i + 3, i + 3] = accel_psd * time_s[:, None]
    return out


def _integrate(derivative: Callable[[float, Array], Array], start: Array, time: Array) -> Array:
    """States (T, n) at the times, which go away from 0, from ``start`` at 0."""
    end = float(time[-1])
    if end == 0.0:
        return np.tile(start, (len(time), 1))
    answer = solve_ivp(derivative, (0.0, end), start, "DOP853", t_eval=time, rtol=1e-8, atol=1e-12)
    if not answer.success:
        raise FloatingPointError(f"the prediction could not be integrated: {answer.message}")
    return np.asarray(answer.y.T)
