"""The predicted motion of the target: its last state propagated as a free rigid body, with its uncertainty.

A flip multiplies small errors, and an undetermined inertia is known only as far as the motion showed it: a
linearised covariance fails there. The last state and the inertia are therefore sampled from their joint
covariance, in pairs of opposite deviations whose second moments are exactly those of the covariance: while
errors stay small the result is the linear one. Each member moves as a free rigid body with its own inertia.

``predict`` gives states and covariances; white disturbances enter by their linearised flow (thesis eqs.
4.56-4.59). ``draw_ensemble`` gives independent members, each with a random path of such disturbances. Their
poses are those of G: what a point fixed to the body does, whether or not its principal axes are known.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.special import chdtr, chdtri, fdtri, gammaincinv, polygamma

from polhode.geometry.lie import (
    Array,
    Ints,
    exp_so3,
    hat,
    log_so3,
    make_pose,
    matrix_from_wxyz,
    transform_points,
    wxyz_from_matrix,
)
from polhode.geometry.rigid_body import angular_acceleration, propagate
from polhode.records.estimate import Prediction
from polhode.runtime.progress import Advance

PAIRS = 128
UNKNOWN_RAD = float(np.sqrt((np.pi**2 / 3.0 + 2.0) / 3.0))
"""Root mean square of each component of the rotation vector of a uniformly distributed attitude."""
SMALLER = 0.7
"""Factors by which changes of the inertia are reduced, so that most end near what is possible."""
LEAST_MOMENT = 0.02
"""Least second moment of a body over its largest"""
SELDOM = 25.0
"""An inertia that needs a beginning so much more exact does not count"""
PAST_TRIES, PAST_STEPS, PAST_STEP, PAST_TOLERANCE = 8, 2, 1e-3, 1e-5
"""To find such a change; of Gauss-Newton; [rad/s] of its derivatives; of the integration"""
IN_REGION = 0.99
"""Share of the errors in the regions of a prediction."""
ROWS_AT_ONCE = 64
"""Instants at which all members are held at once: it bounds the memory of long predictions."""


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
    """(H,) instants < 0 before the last one, descending, that bound an undetermined inertia"""
    past_R_NG: Array | None = None
    """(H, 3, 3) attitudes there"""


@dataclass(frozen=True)
class PredictedMotion(Prediction):
    """The prediction of a run, with the timestamps of its dataset."""

    timestamps_ns: Ints
    """(T,)"""
    undetermined: tuple[str, ...]
    """Names of the quantities that the run's motion does not determine; inf on the covariance's diagonal"""
    R_GP: Array
    """(3, 3) principal axes in G"""
    com_G: Array
    """(3,) centre of mass in G [m]"""
    ranges: tuple[str, ...] = ()
    """Where these can lie, each a description; empty: nothing bounds them"""

    @property
    def X_NG(self) -> Array:
        """(T, 4, 4) pose of the body frame G, which map and mesh are in [m]."""
        R_NG = self.R_NP @ self.R_GP.T
        return make_pose(R_NG, self.r_N - R_NG @ self.com_G)

    def points_N(self, p_G: ArrayLike) -> Array:
        """Places in N [m] of points fixed to the target: (T, n, 3) of p_G (n, 3), (T, 3) of one (3,)."""
        points = np.asarray(p_G, dtype=np.float64)
        places = transform_points(self.X_NG, np.atleast_2d(points))
        return places[:, 0] if points.ndim == 1 else places

    def points_covariance(self, p_G: ArrayLike) -> Array:
        """Covariance along N [m^2] of ``points_N``: (T, n, 3, 3) of p_G (n, 3), (T, 3, 3) of one (3,).

        To first order, from ``covariance_of_marks``: the points are exact in G.
        """
        points = np.asarray(p_G, dtype=np.float64)
        lever_P, R = (np.atleast_2d(points) - self.com_G) @ self.R_GP, self.R_NP[:, None]
        by_turn = -R @ hat(lever_P)
        jacobian = np.concatenate([np.broadcast_to(np.eye(3), by_turn.shape), by_turn], axis=-1)
        pose = np.r_[0:3, 6:9]
        covariance = self.covariance_of_marks[:, None, pose[:, None], pose]
        found = np.asarray(jacobian @ covariance @ np.swapaxes(jacobian, -1, -2))
        return found[:, 0] if points.ndim == 1 else found


def predict(
    last: FinalState,
    time_s: ArrayLike,
    accel_psd: float,
    torque_psd: float,
    level_decades: tuple[float, float] = (0.0, 0.0),
    advance: Advance = lambda: None,
) -> Prediction:
    """Propagate to time_s (T,), increasing, >= 0 [s] after the last state.

    accel_psd [(m/s^2)^2/Hz]; torque_psd [(rad/s^2)^2/Hz], torque over the middle moment: means; their
    logarithms have the standard deviations level_decades. ``advance`` is called after every ROWS_AT_ONCE
    rows, and after the last ones.
    """
    time = np.asarray(time_s, dtype=np.float64)
    grid = time if time[0] == 0.0 else np.concatenate([[0.0], time])
    states = propagate(grid, last.r_N, last.v_N, last.R_NG, last.w_G, last.J_G)
    r_N, v_N, R_NG, w_G = (each[len(grid) - len(time) :] for each in states)
    R_NP, R_GP, w_P = R_NG @ last.R_GP, last.R_GP, w_G @ last.R_GP
    deviation, J = draw_deviations(last)
    # rotation of each member's principal axes relative to the estimated ones
    turn = exp_so3(deviation[:, 12:17] @ axes_jacobian(last).T)
    com = deviation[:, 17:20]
    moments = np.diag(R_GP.T @ last.J_G @ R_GP)
    moments = moments / moments[1]
    of_axes = process_noise(moments, last.w_G @ R_GP, time, accel_psd, torque_psd)
    # an error of the attitude of s radians bends by s^2 / 2 off the direction of the linear flow
    bend, k = (0.5 * np.linalg.eigvalsh(of_axes[:, 6:9, 6:9])[:, -1]) ** 2, np.arange(6, 12)
    of_axes[:, k, k] += bend[:, None] * np.repeat([1.0, last.w_G @ last.w_G], 3)
    # of a rate in any direction, of the size at the start and what may have been added since
    rate = np.sum(w_P**2, axis=1) + np.trace(last.covariance[9:12, 9:12])
    rate += torque_psd * time * np.sum(moments**-2.0)
    most = np.sqrt(np.hstack([np.full_like(w_P, UNKNOWN_RAD**2), rate[:, None] + w_P**2]))
    of_marks, of_noise = of_axes.copy(), np.diagonal(of_axes, axis1=1, axis2=2).copy()
    by_last_state, of_state = _by_last_state(deviation), np.empty_like(of_noise)
    tails = np.empty((len(time), 4))
    for rows, R, w in _members_by_blocks(last, deviation, J, time):
        dr = deviation[:, 0:3] + time[rows, None, None] * deviation[:, 3:6]
        dv = np.broadcast_to(deviation[:, 3:6], dr.shape)
        R_PP = np.swapaxes(R_NP[rows], 1, 2)[:, None] @ R @ R_GP

        dw = np.einsum("nji,tnj->tni", R_GP @ turn, w) - w_P[rows, None]
        own = np.concatenate([dr, dv, log_so3(R_PP @ turn), dw], axis=-1)
        of_axes[rows] += _second_moments(own)
        of_state[rows] = np.mean((by_last_state @ own) ** 2, axis=1)

        lever = np.einsum("tnij,nj->tni", R, com)
        swing = np.einsum("tnij,tnj->tni", R, np.cross(w, com))
        dw = (w - w_G[rows, None]) @ R_GP
        marks = np.concatenate([dr - lever, dv - swing, log_so3(R_PP), dw], axis=-1)
        of_marks[rows] += _second_moments(marks)
        tails[rows] = np.maximum(_fourth_moments(own), _fourth_moments(marks))
        for covariance in (of_axes, of_marks):
            covariance[rows] = _no_worse_than_unknown(covariance[rows], most[rows])
        advance()
    whole = np.diagonal(of_axes, axis1=1, axis2=2)
    by_inertia = np.maximum(whole - of_noise - of_state, 0.0)
    parts = np.sqrt(np.stack([of_state, by_inertia, of_noise], axis=1))
    share = (of_noise / np.maximum(whole, 1e-300)).reshape(-1, 4, 3).max(axis=2)
    accel, torque = level_decades
    regions = np.hstack([region_sigmas(share[:, :2], accel), region_sigmas(share[:, 2:], torque)])
    # disturbances without tails leave this of the members'
    regions = np.maximum(regions, _region_by_tails(1.0 + (1.0 - share) ** 2 * (tails - 1.0)))
    return Prediction(time, r_N, v_N, R_NP, w_P, of_axes, of_marks, parts, regions)


def _by_last_state(deviation: Array) -> Array:
    """(N, N) of errors of N members to what of them is linear in the deviations (N, 20) of their states."""
    of_state_and_inertia = deviation[:, :17]
    scale = np.sqrt(np.mean(of_state_and_inertia**2, axis=0))
    regressors = of_state_and_inertia / np.where(scale > 0.0, scale, 1.0)
    return np.asarray(regressors[:, :12] @ np.linalg.pinv(regressors, rcond=1e-9)[:12])


def power_shape(decades: float) -> float:
    """Shape of the gamma distribution of a power whose logarithm has this standard deviation; inf: exact.

    A gamma distribution has a long tail towards powers that make no difference, as what is known of a
    level that the data hardly resolve.
    """
    variance = (np.log(10.0) * decades) ** 2
    if variance < 1e-6:
        return np.inf
    return float(np.exp(brentq(lambda log_shape: polygamma(1, np.exp(log_shape)) - variance, -20.0, 20.0)))


def region_sigmas(noise_share: Array, decades: float) -> Array:
    """(...,) standard deviations that a region of three components extends which holds 99 % of the errors.

    noise_share (...,): of the variance, by disturbances of a level that is gamma distributed.
    """
    shape, share = power_shape(decades), np.linspace(0.0, 1.0, 65)
    if not np.isfinite(shape):
        return np.full(noise_share.shape, np.sqrt(chdtri(3.0, 1.0 - IN_REGION)))
    # levels that are equally likely, of mean 1
    levels = gammaincinv(shape, (np.arange(512) + 0.5) / 512)
    variance = np.maximum(1.0 + share[:, None] * (levels / levels.mean() - 1.0), 1e-12)
    squares = [brentq(lambda s, of=of: chdtr(3.0, s / of).mean() - IN_REGION, 0.0, 1e4) for of in variance]
    return np.asarray(np.interp(noise_share, share, np.sqrt(squares)))


def _region_by_tails(tails: Array) -> Array:
    """As ``region_sigmas``, of Student's distribution; tails (...,): fourth moments, 1 of a normal one."""
    freedom = (4.0 * tails - 2.0) / np.maximum(tails - 1.0, 1e-6)
    return np.asarray(np.sqrt(3.0 * (1.0 - 2.0 / freedom) * fdtri(3.0, freedom, IN_REGION)))


def draw_deviations(last: FinalState, normal: Array | None = None) -> tuple[Array, Array]:
    """Deviations (n, 20) from the last state, and the inertias (n, 3, 3) that go with them.

    ``normal`` (n, 20): independent standard normal numbers. Without: 2 PAIRS whose moments are exact.
    """
    root = _root(last.covariance)
    if normal is None:
        z = np.random.default_rng([0, 60]).normal(size=(PAIRS, len(root)))
        z = z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / PAIRS)).T
        normal = np.concatenate([z, -z])
    deviation = normal @ root.T
    # linear in the parameters, so that directions without variance, such as off a spin axis, stay without
    change = np.einsum("nk,kij->nij", deviation[:, 12:17], last.J_jacobian)
    share = _largest_share(last, change)
    if last.past_s is not None and last.past_R_NG is not None:
        # what of the attitude and the rate is left open when the inertia is given
        by_inertia = np.linalg.pinv(last.covariance[12:17, 12:17], rcond=1e-12) @ last.covariance[12:17, 6:12]
        own = deviation[:, 6:12] - deviation[:, 12:17] @ by_inertia
        share, fitted = _consistent_with_past(last, last.past_s, last.past_R_NG, share, change)
        deviation[:, 6:12] = own + fitted
    deviation[:, 12:17] *= share[:, None]
    return deviation, last.J_G + share[:, None, None] * change


def _root(covariance: Array) -> Array:
    """(n, n) whose product with its transpose is the covariance (n, n)."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _largest_share(last: FinalState, change: Array) -> Array:
    """Shares (N,) of the changes (N, 3, 3), reduced until J + share change is a possible body.

    Second moments: the least over the largest is at least LEAST_MOMENT, or half of the estimate's.
    """
    share, least = np.ones(len(change)), min(LEAST_MOMENT, 0.5 * float(_least_moment(last.J_G)))
    for _ in range(40):
        bad = _least_moment(last.J_G + share[:, None, None] * change) < least
        if not bad.any():
            break
        share[bad] *= SMALLER
    return share


def _least_moment(J: Array) -> Array:
    """The least over the largest second moment of inertias (..., 3, 3)."""
    half_trace = 0.5 * np.trace(J, axis1=-2, axis2=-1)[..., None, None]
    values = np.linalg.eigvalsh(half_trace * np.eye(3) - J)
    return np.asarray(values[..., 0] / values[..., 2])


def _consistent_with_past(
    last: FinalState, past_s: Array, past_R_NG: Array, share: Array, change: Array
) -> tuple[Array, Array]:
    """Shares (N,) of the changes of J, reduced until the member's past agrees with the observed one, and the
    deviations (N, 6) of attitude and rate at the end that make it agree best.

    A linear covariance admits bodies whose spin would have flipped long ago, and misses those that spin about
    the intermediate axis steadily, as they began so. The past may differ from the observed one by twice the
    estimate's own difference and three standard deviations of attitude and rate; and the beginnings that lead
    to it must not be SELDOM times rarer than the estimate's.
    """
    prior = np.linalg.inv(last.covariance[6:12, 6:12])
    variance = np.diag(last.covariance)[6:12]
    per, near = 1.0 / variance[:3].mean(), PAST_STEP * np.eye(7, 6, -1)[[0, 4, 5, 6]]

    def off(x: Array, J: Array) -> tuple[Array, Array]:
        """(H, N, 3) rotations from the observed past to that of members with deviations x (N, 6), and the
        attitudes of these (H, N, 3, 3).
        """
        deviation = np.zeros((len(x), 20))
        deviation[:, 6:12] = x
        R, _ = propagate_members(last, deviation, J, past_s, PAST_TOLERANCE)
        return log_so3(np.swapaxes(past_R_NG, -1, -2)[:, None] @ R), R

    def best(J: Array) -> tuple[Array, Array, Array]:
        """By Gauss-Newton: deviations (N, 6), the angles (H, N) that are left, and the logarithm of the share
        (N,) of all beginnings that are left.
        """
        x, H = np.zeros((len(J), 6)), np.zeros((len(J), 6, 6))
        for _ in range(PAST_STEPS):
            # each member and its neighbours in rate at once
            found, R = off((x + near[:, None]).reshape(-1, 6), np.tile(J, (len(near), 1, 1)))
            left, *beside = np.moveaxis(found.reshape(len(past_s), len(near), *x.shape[:1], 3), 1, 0)
            # the rotation since does not depend on the attitude
            by_attitude = np.swapaxes(R[:, : len(x)], -1, -2) @ (last.R_NG @ exp_so3(x[:, :3]))
            by_rate = np.stack([(each - left) / PAST_STEP for each in beside], axis=-1)
            A = np.concatenate([by_attitude, by_rate], axis=-1)
            H = per * np.einsum("hnia,hnib->nab", A, A) + prior
            g = per * np.einsum("hnia,hni->na", A, left) + x @ prior
            x = x - np.linalg.solve(H, g[..., None])[..., 0]
        return x, np.linalg.norm(off(x, J)[0], axis=-1), -0.5 * np.linalg.slogdet(H)[1]

    own = np.linalg.norm(off(np.zeros((1, 6)), last.J_G[None])[0], axis=-1)
    fewest = best(last.J_G[None])[2][0] - np.log(SELDOM)
    limit = np.sqrt(4.0 * own**2 + 9.0 * (variance[:3].sum() + variance[3:].sum() * past_s[:, None] ** 2))
    share, fitted, open_ = share.copy(), np.zeros((len(change), 6)), np.arange(len(change))
    for _ in range(PAST_TRIES):
        fitted[open_], left, begin = best(last.J_G + share[open_, None, None] * change[open_])
        open_ = open_[~((left <= limit).all(axis=0) & (begin > fewest))]
        if len(open_) == 0:
            return share, fitted
        share[open_] *= SMALLER
    share[open_], fitted[open_] = 0.0, 0.0
    return share, fitted


def axes_jacobian(last: FinalState) -> Array:
    """Derivative (3, 5) of theta in R_GP Exp(theta); zero for equal moments, whose axes are undefined."""
    changes = last.R_GP.T @ last.J_jacobian @ last.R_GP
    values = np.diag(last.R_GP.T @ last.J_G @ last.R_GP)
    gaps = np.array([values[1] - values[2], values[2] - values[0], values[0] - values[1]])
    turns = np.stack([changes[:, 2, 1], changes[:, 0, 2], changes[:, 1, 0]])
    known = np.abs(gaps) > 1e-9 * values[1]
    return np.where(known, 1.0, 0.0)[:, None] * turns / np.where(known, gaps, 1.0)[:, None]


def propagate_members(
    last: FinalState, deviation: Array, J: Array, time: Array, rtol: float = 1e-8
) -> tuple[Array, Array]:
    """Attitudes (T, N, 3, 3) and rates (T, N, 3) in G of all members, at all times (T,) at once."""
    R_NG = np.empty((len(time), len(deviation), 3, 3))
    w_G = np.empty((len(time), len(deviation), 3))
    for rows, R, w in _members_by_blocks(last, deviation, J, time, rtol):
        R_NG[rows], w_G[rows] = R, w
    return R_NG, w_G


def _members_by_blocks(
    last: FinalState, deviation: Array, J: Array, time: Array, rtol: float = 1e-8
) -> Iterator[tuple[slice, Array, Array]]:
    """Consecutive times, and attitudes (t, N, 3, 3) and rates (t, N, 3) in G of all members there."""
    n = len(deviation)
    q = wxyz_from_matrix(last.R_NG @ exp_so3(deviation[:, 6:9]))
    start = np.concatenate([q.T, (last.w_G + deviation[:, 9:12]).T]).ravel()
    J_inv = np.linalg.inv(J)

    def derivative(_: float, state: Array) -> Array:
        q0, q1, q2, q3, a, b, c = state.reshape(7, n)
        x, y, z = np.einsum("nij,nj->in", J, np.stack([a, b, c], axis=1))
        # written out, as np.cross takes most of the time
        torque = np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
        w_dot = np.einsum("nij,nj->ni", J_inv, torque)
        q_dot = 0.5 * np.stack(
            [
                -q1 * a - q2 * b - q3 * c,
                q0 * a + q2 * c - q3 * b,
                q0 * b + q3 * a - q1 * c,
                q0 * c + q1 * b - q2 * a,
            ]
        )
        return np.concatenate([q_dot, w_dot.T]).ravel()

    for rows, states in _integrate(derivative, start, time, rtol):
        parts = np.moveaxis(states.reshape(-1, 7, n), 1, 2)
        q = parts[..., :4] / np.linalg.norm(parts[..., :4], axis=-1, keepdims=True)
        yield rows, matrix_from_wxyz(q), parts[..., 4:]


def _second_moments(d: Array) -> Array:
    """Mean square (T, 12, 12) of deviations (T, N, 12) about the prediction itself."""
    return np.asarray(np.swapaxes(d, 1, 2) @ d / d.shape[1])


def _fourth_moments(d: Array) -> Array:
    """Of deviations (T, N, 12) in position, velocity, attitude, rate: (T, 4), 1 of normal distributions.

    Less twice what the mean of three components of independent pairs scatters, and no less than 1.
    """
    squares = d**2
    normal = 3.0 * np.maximum(squares.mean(axis=1), 1e-100) ** 2
    moments = (squares**2).mean(axis=1) / normal
    scatter = np.sqrt(96.0 / 3.0 / PAIRS) / 3.0
    return np.asarray(np.maximum(moments.reshape(-1, 4, 3).mean(axis=2) - 2.0 * scatter, 1.0))


def _no_worse_than_unknown(covariance: Array, most: Array) -> Array:
    """(T, 12, 12), with standard deviations of attitude and rate of at most those (T, 6) of any direction."""
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, 6:])
    factor = np.ones(covariance.shape[:2])
    factor[:, 6:] = most / np.maximum(sigma, most)
    return np.asarray(factor[:, :, None] * covariance * factor[:, None, :])


def process_noise(moments: Array, w_P: Array, time_s: Array, accel_psd: float, torque_psd: float) -> Array:
    """Covariance (T, 12, 12) of r (N), v (N), theta (P), w (P) due to white disturbances.

    moments (3,), middle one 1; w_P (3,) [rad/s] at the start; time_s (T,) >= 0 [s], increasing.
    """

    def derivative(_: float, y: Array) -> Array:
        w, Q = y[:3], y[3:].reshape(6, 6)
        A = _attitude_error_dynamics(w, moments)
        Q_dot = A @ Q + Q @ A.T
        # of a unit of torque: the integrator's tolerance is absolute, too
        Q_dot[3:, 3:] += np.diag(1.0 / moments**2)
        return np.concatenate([np.cross(moments * w, w) / moments, Q_dot.ravel()])

    out, i = np.zeros((len(time_s), 12, 12)), np.arange(3)
    for rows, states in _integrate(derivative, np.concatenate([w_P, np.zeros(36)]), time_s):
        out[rows, 6:, 6:] = torque_psd * states[:, 3:].reshape(-1, 6, 6)
    out[:, i, i] = accel_psd * time_s[:, None] ** 3 / 3
    out[:, i, i + 3] = out[:, i + 3, i] = accel_psd * time_s[:, None] ** 2 / 2
    out[:, i + 3, i + 3] = accel_psd * time_s[:, None]
    return out


def _attitude_error_dynamics(w: Array, moments: Array) -> Array:
    """A (..., 6, 6) of theta' = -w x theta + dw;  dw' = J^-1 ((J w) x - w x J) dw, with w (..., 3) in P."""
    A = np.zeros((*w.shape[:-1], 6, 6))
    A[..., :3, :3], A[..., :3, 3:] = -hat(w), np.eye(3)
    A[..., 3:, 3:] = (hat(moments * w) - hat(w) * moments) / moments[:, None]
    return A


def _integrate(
    derivative: Callable[[float, Array], Array], start: Array, time: Array, rtol: float = 1e-8
) -> Iterator[tuple[slice, Array]]:
    """At most ROWS_AT_ONCE consecutive times, and the states (t, n) there; until all times (T,) are reached.

    They move monotonically away from 0, where the state is ``start``. Dormand-Prince 8(5,3): its steps do not
    depend on the times, at which its interpolant gives the states.
    """
    if time[-1] == 0.0:
        yield slice(0, 1), start[None]
        return
    solver = DOP853(derivative, 0.0, start, float(time[-1]), rtol=rtol, atol=1e-4 * rtol)
    distance = np.abs(time)
    first = done = 0
    block = np.empty((min(ROWS_AT_ONCE, len(time)), len(start)))
    while done < len(time):
        message = solver.step()
        if solver.status == "failed":
            raise FloatingPointError(f"the prediction could not be integrated: {message}")
        reached = int(np.searchsorted(distance, abs(solver.t), side="right"))
        if done == reached:
            continue
        interpolant = solver.dense_output()
        while done < reached:
            stop = min(reached, first + len(block))
            block[done - first : stop - first] = interpolant(time[done:stop]).T
            done = stop
            if done == first + len(block):
                yield slice(first, done), block
                first, block = done, np.empty((min(ROWS_AT_ONCE, len(time) - done), len(start)))


MEMBERS_AT_ONCE = 250
"""Members of an ensemble that are propagated together"""


@dataclass(frozen=True)
class FinalEstimate:
    """The target at the end of a run, from which members are sampled."""

    last: FinalState
    com_G: Array
    """(3,) [m]"""
    accel_psd: float
    """[(m/s^2)^2/Hz]"""
    torque_psd: float
    """[(rad/s^2)^2/Hz], torque over the middle moment; both are means"""
    com_range_G: tuple[Array, Array] | None = None
    """Least and largest components (3,) of the centre of mass [m] by other bounds; None: there are none"""
    level_decades: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of the logarithms of both levels [decades]"""


@dataclass(frozen=True)
class BodyMotion:
    """The estimate, propagated to T instants."""

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
    """Poses of G in n sampled members at T instants."""

    R_NG: Array
    """(n, T, 3, 3)"""
    p_NG: Array
    """(n, T, 3) [m]"""

    def part(self, chosen: slice) -> "Ensemble":
        """A subset."""
        return Ensemble(self.R_NG[chosen], self.p_NG[chosen])


def nominal_motion(estimate: FinalEstimate, time_s: Array) -> BodyMotion:
    """The estimate at times (T,) >= 0 [s], increasing."""
    last, grid = estimate.last, time_s if time_s[0] == 0.0 else np.concatenate([[0.0], time_s])
    states = propagate(grid, last.r_N, last.v_N, last.R_NG, last.w_G, last.J_G, rtol=1e-10)
    r_N, v_N, R_NG, w_G = (each[len(grid) - len(time_s) :] for each in states)
    w_dot_G = angular_acceleration(last.J_G, w_G)
    w_N, w_dot_N = (np.einsum("tij,tj->ti", R_NG, each) for each in (w_G, w_dot_G))
    return BodyMotion(time_s, R_NG, r_N - R_NG @ estimate.com_G, r_N, v_N, w_N, w_dot_N)


def draw_ensemble(estimate: FinalEstimate, time_s: Array, count: int, seed: int) -> Ensemble:
    """Independent members at times (T,) > 0 [s], increasing; the same seed gives the same members."""
    rng = np.random.default_rng([seed, 8])
    R_all = np.empty((count, len(time_s), 3, 3))
    p_all = np.empty((count, len(time_s), 3))
    disturbed = DisturbancePaths(estimate, time_s)
    for start in range(0, count, MEMBERS_AT_ONCE):
        n = min(MEMBERS_AT_ONCE, count - start)
        deviation, J = _draw_in_range(estimate, n, rng)
        R, _ = propagate_members(estimate.last, deviation, J, time_s)
        shift, turn_G = disturbed.paths(n, rng)
        R = np.swapaxes(R, 0, 1) @ exp_so3(turn_G)
        r = estimate.last.r_N + deviation[:, None, 0:3]
        r = r + time_s[:, None] * (estimate.last.v_N + deviation[:, None, 3:6]) + shift
        R_all[start : start + n] = R
        com = estimate.com_G + deviation[:, 17:20]
        p_all[start : start + n] = r - np.einsum("ntij,nj->nti", R, com)
    return Ensemble(R_all, p_all)


def _draw_in_range(estimate: FinalEstimate, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """As ``draw_deviations``; members with a centre of mass out of its range are drawn again, and put to its
    end where that does not help in 30 draws.
    """
    normal = rng.normal(size=(count, 20))
    if estimate.com_range_G is None:
        return draw_deviations(estimate.last, normal)
    low, high = (end - estimate.com_G for end in estimate.com_range_G)
    of_com = _root(estimate.last.covariance)[17:20]
    for _ in range(30):
        com = normal @ of_com.T
        outside = np.flatnonzero(((com < low) | (com > high)).any(axis=1))
        if len(outside) == 0:
            break
        normal[outside] = rng.normal(size=(len(outside), 20))
    deviation, J = draw_deviations(estimate.last, normal)
    deviation[:, 17:20] = np.clip(deviation[:, 17:20], low, high)
    return deviation, J


class DisturbancePaths:
    """White accelerations and torques, as random paths of position and attitude about the nominal motion.

    Each path has levels of its own, as far as they are uncertain.
    """

    def __init__(self, estimate: FinalEstimate, time_s: Array) -> None:
        """Prepare the steps between times (T,) > 0 [s], the first one from 0."""
        last = estimate.last
        self.step_s = np.diff(time_s, prepend=0.0)
        self.accel_psd, self.R_GP = estimate.accel_psd, last.R_GP
        self.shapes = [power_shape(decades) for decades in estimate.level_decades]
        moments = np.diag(last.R_GP.T @ last.J_G @ last.R_GP)
        moments = moments / moments[1]
        middle = time_s - 0.5 * self.step_s
        at_rest = np.zeros(3), np.zeros(3)
        times = np.concatenate([[0.0], middle])
        states = propagate(times, *at_rest, last.R_NG, last.w_G, last.J_G, rtol=1e-8)
        w = states[3][1:] @ last.R_GP
        # at the rate in the middle of each step
        A = _attitude_error_dynamics(w, moments)
        S = np.zeros((6, 6))
        S[3:, 3:] = estimate.torque_psd * np.diag(1.0 / moments**2)
        half = expm(0.5 * self.step_s[:, None, None] * A)
        self.flow = half @ half
        # Simpson's rule for the integrated process noise
        grown = self.flow @ S @ np.swapaxes(self.flow, 1, 2) + S
        grown = grown + 4.0 * half @ S @ np.swapaxes(half, 1, 2)
        values, vectors = np.linalg.eigh(self.step_s[:, None, None] / 6.0 * grown)
        self.root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]

    def paths(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Translations along N [m] and rotations along G [rad], (count, T, 3) each."""
        T = len(self.step_s)
        shift, turn = np.empty((count, T, 3)), np.empty((count, T, 3))
        x, r, v = np.zeros((count, 6)), np.zeros((count, 3)), np.zeros((count, 3))
        accel, torque = (
            np.sqrt(rng.gamma(shape, 1.0 / shape, (count, 1))) if np.isfinite(shape) else np.ones((count, 1))
            for shape in self.shapes
        )
        for k, dt in enumerate(self.step_s):
            x = x @ self.flow[k].T + torque * rng.normal(size=(count, 6)) @ self.root[k].T
            kick, inside = accel * rng.normal(size=(2, count, 3)) * np.sqrt(self.accel_psd * dt)
            r = r + dt * (v + 0.5 * kick + inside / np.sqrt(12.0))
            v = v + kick
            shift[:, k], turn[:, k] = r, x[:, :3] @ self.R_GP.T
        return shift, turn


def pose_covariance(members: Ensemble, motion: BodyMotion, com_G: Array) -> Array:
    """Second moments (T, 6, 6) of shift [m] and turn [rad] along G: p_N = X_NG (Exp(turn) p_G + shift).

    The shift is that of the centre of mass, moved to the origin of G as small turns move it: however far the
    members have turned, that centre has the sigma that it has.
    """
    back = np.swapaxes(motion.R_NG, 1, 2)
    of_com = members.p_NG + members.R_NG @ com_G - (motion.p_NG + motion.R_NG @ com_G)
    shift = np.einsum("tij,ntj->nti", back, of_com)
    turn = log_so3(back @ members.R_NG)
    # the shift of the origin: that of the centre less turn x com
    both = np.concatenate([shift - np.cross(turn, com_G), turn], axis=-1)
    return np.asarray(np.einsum("nti,ntj->tij", both, both) / len(both))
