"""A known wrench over the steps between frames: impulses of the force, torque over each Taylor series.

With a known wrench there are further unknowns besides the motion: the scale of the inertia, the mass,
constant biases of force and torque, and the orientation in G of the axes along which the torque is given.
These are the principal axes, so the products of inertia vanish in them (``alignment``); where moments are
nearly equal this is a weak constraint, and the orientation follows from the effect of the torques.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, Bools, Ints, exp_so3, hat, right_jacobian_so3
from polhode.records.tracks import Wrench

N_WRENCH = 11
"""ln of the inertia's scale; rotation of the torque's axes (3) [rad]; bias of the torque (3) [N m]; ln of the
mass in kg; bias of the force (3) [N]. J in kg m^2 is the scale times J of unit second moments."""
LN_SCALE, TURN, TORQUE_BIAS, LN_MASS, FORCE_BIAS = 0, slice(1, 4), slice(4, 7), 7, slice(8, 11)
N_OF_ROTATION = 7
"""The first unknowns, which act on the rotation."""
LN_PRIOR = 8.0
"""Standard deviation of the weak prior on the logarithms, about 1 kg and 1 kg m^2."""
ALIGNMENT_SIGMA = 1e-3
"""Standard deviation of the products of inertia in the torque's axes, over the mean moment: a stiffer
constraint slows the solver down."""
FINEST_TURN_RAD = 0.25
"""Rotation of the body in one series while a torque acts: within it the torque is taken to change
linearly."""


@dataclass(frozen=True)
class Impulses:
    """Integrals of a known wrench; times in seconds since the first frame, F frames."""

    frame_s: Array
    """(F,)"""
    row_s: Array
    """(n,) where each row begins"""
    rows: Array
    """(n, 6) force along N [N], torque along P [N m]"""
    once: Array
    """(n, 6) integral up to each row"""
    twice: Array
    """(n, 6) integral of that"""

    def integrals(self, time_s: Array) -> tuple[Array, Array]:
        """Integral (..., 6) of the wrench up to the times, and its integral."""
        row = np.searchsorted(self.row_s, time_s, side="right") - 1
        t = np.maximum(np.asarray(time_s) - self.row_s[np.maximum(row, 0)], 0.0)[..., None]
        row = np.maximum(row, 0)
        once = self.once[row] + self.rows[row] * t
        return once, self.twice[row] + self.once[row] * t + 0.5 * self.rows[row] * t**2

    @property
    def cumulative(self) -> Array:
        """(F, 6) integral of force and torque from the first frame to each [N s, N m s]."""
        once, _ = self.integrals(self.frame_s)
        return np.asarray(once - once[0])

    @property
    def force_increments(self) -> Array:
        """(F - 1, 2, 3) effect of the force on position [N s^2] and velocity [N s] of 1 kg, in each step."""
        once, twice = (whole[:, :3] for whole in self.integrals(self.frame_s))
        dt = np.diff(self.frame_s)[:, None]
        return np.stack([np.diff(twice, axis=0) - dt * once[:-1], np.diff(once, axis=0)], axis=1)

    @property
    def acting(self) -> Bools:
        """(F - 1,) steps in which the wrench is not zero."""
        size = np.abs(self.rows)
        magnitude = Impulses(self.frame_s, self.row_s, size, *_integrate(self.row_s, size))
        return np.asarray(np.diff(magnitude.integrals(self.frame_s)[0], axis=0).max(axis=1) > 0.0)

    @property
    def largest(self) -> tuple[float, float]:
        """Largest force [N] and torque [N m]."""
        return (
            float(np.linalg.norm(self.rows[:, :3], axis=1).max()),
            float(np.linalg.norm(self.rows[:, 3:], axis=1).max()),
        )

    def torque(self, series: Ints) -> Array:
        """(F - 1, S, 2, 3) along P [N m], S the largest of series (F - 1,): value at the start, and change.

        It is the straight line with the same integral and first moment over each series.
        """
        n, most = len(series), int(series.max())
        h = np.diff(self.frame_s) / series
        edges = self.frame_s[:-1, None] + h[:, None] * np.minimum(np.arange(most + 1), series[:, None])
        once, twice = (whole[..., 3:] for whole in self.integrals(edges))
        h = h[:, None, None]
        mean = np.diff(once, axis=1) / h
        moment = (h * once[:, 1:] - np.diff(twice, axis=1)) / h**2
        change = 12.0 * (moment - 0.5 * mean)
        out = np.stack([mean - 0.5 * change, change], axis=2)
        out[np.arange(most) >= series[:, None]] = 0.0
        return np.asarray(out).reshape(n, most, 2, 3)

    def refine_series(self, series: Ints, w_G: Array, dt_s: Array) -> Ints:
        """Numbers of series (F - 1,), increased where a torque acts; w_G (F - 1, 3) [rad/s]."""
        turns = np.linalg.norm(w_G, axis=1) * dt_s / FINEST_TURN_RAD
        needed = (2 ** np.ceil(np.log2(np.maximum(turns, 2.0)))).astype(np.int64)
        return np.where(self.acting, np.maximum(series, needed), series)


def impulses_of(wrench: Wrench, timestamps_ns: Ints) -> Impulses:
    """Integrate a known wrench; frames at timestamps_ns (F,)."""
    # differences of whole nanoseconds first: those since 1970 do not fit a double
    frame_s = (timestamps_ns - timestamps_ns[0]) * 1e-9
    row_s = (wrench.time_ns - timestamps_ns[0]) * 1e-9
    rows = np.hstack([wrench.force_N, wrench.torque_P])
    return Impulses(frame_s, row_s, rows, *_integrate(row_s, rows))


def _integrate(row_s: Array, rows: Array) -> tuple[Array, Array]:
    dt = np.diff(row_s)[:, None]
    once = np.concatenate([np.zeros((1, 6)), np.cumsum(rows[:-1] * dt, axis=0)])
    twice = np.cumsum(once[:-1] * dt + 0.5 * rows[:-1] * dt**2, axis=0)
    return once, np.concatenate([np.zeros((1, 6)), twice])


def torque_in_G(torque_P: Array, unknowns: Array, R_ref: Array) -> tuple[Array, Array]:
    """Torque (n, S, 2, 3) along G in the scale of J_G, and its derivatives (n, S, 7, 2, 3).

    torque_P (n, S, 2, 3) [N m]; unknowns (11,); R_ref (3, 3) reference of the torque's axes in G. Derivatives
    with respect to ln scale, rotation, bias.
    """
    R = R_ref @ exp_so3(unknowns[TURN]) * np.exp(-unknowns[LN_SCALE])
    biased = torque_P.copy()
    biased[:, :, 0] += unknowns[TORQUE_BIAS]
    torque = biased @ R.T
    out = np.zeros((*torque_P.shape[:2], N_OF_ROTATION, 2, 3))
    out[:, :, 0] = -torque
    out[:, :, 1:4] = np.moveaxis(-R @ hat(biased) @ right_jacobian_so3(unknowns[TURN]), -1, 2)
    out[:, :, 4:7, 0] = R.T
    return torque, out


def wrench_residual(
    J_G: Array, dJ: Array, unknowns: Array, R_ref: Array, bias_sigma: tuple[float, float]
) -> tuple[Array, Array]:
    """Prior on the unknowns (11,), whitened, and its Jacobian (11, 16) with respect to xi and the unknowns.

    Rows: alignment (3), biases of torque and force (6) over bias_sigma [N, N m], the two logarithms.
    """
    aligned, jacobian = alignment(J_G, dJ, unknowns, R_ref)
    residual, D = np.zeros(N_WRENCH), np.zeros((N_WRENCH, 5 + N_WRENCH))
    residual[:3], D[:3, :5], D[:3, 6:9] = aligned, jacobian[:, :5], jacobian[:, 5:]
    at = np.r_[4:7, 8:11, LN_SCALE, LN_MASS]
    sigma = np.repeat([bias_sigma[1], bias_sigma[0], LN_PRIOR], [3, 3, 2])
    residual[3:], D[np.arange(3, N_WRENCH), 5 + at] = unknowns[at] / sigma, 1.0 / sigma
    return residual, D


def alignment(J_G: Array, dJ: Array, unknowns: Array, R_ref: Array) -> tuple[Array, Array]:
    """Products of inertia (3,) in the torque's axes over their sigma; Jacobian (3, 8) in xi and rotation."""
    R = R_ref @ exp_so3(unknowns[TURN])
    scale = 1.0 / (ALIGNMENT_SIGMA * np.trace(J_G) / 3.0)
    M = R.T @ J_G @ R
    of_xi = R.T @ dJ @ R
    # derivative for R Exp(d): M hat(d) - hat(d) M, with d along each column of the right Jacobian
    turns = hat(right_jacobian_so3(unknowns[TURN]).T)
    of_turn = M @ turns - turns @ M
    rows, cols = [2, 2, 1], [1, 0, 0]
    jacobian = np.concatenate([of_xi, of_turn])[:, rows, cols].T * scale
    size = np.trace(dJ, axis1=1, axis2=2) / np.trace(J_G)
    jacobian[:, :5] -= np.outer(M[rows, cols] * scale, size)
    return M[rows, cols] * scale, jacobian
