"""Other parameters of the inertia: x = x(z), where z has parameters u and eta instead of xi.

``log_ratios``: the thesis's k1, k2 (eqs. 4.97-4.99). ``aghili...``: Aghili's three (eqs. 4.89-4.91), one more
than the degrees of freedom: ``aghili`` takes the nearest body, ``aghili_held`` enforces their dependence too,
in ``aghili_free`` they are free in Euler's equation. ``lichter``: Lichter's quaternion (eqs. 4.93-4.96), four
numbers for two. The principal axes are R_ref Exp(eta).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_diag, csr_matrix, identity

from polhode.backend.dynamics.propagation import ORDER
from polhode.backend.dynamics.residuals import FrameStates, jacobians_of_propagation
from polhode.backend.dynamics.so3_exp import matrices_from_quaternions
from polhode.backend.problem.inertia import N_INERTIA
from polhode.compare.problem.blocks import Block, Blocks
from polhode.compare.problem.measured_problem import MeasuredProblem, inertia_around
from polhode.errors import RunFailure
from polhode.lie import Array, exp_so3, hat, right_jacobian_so3
from polhode.records import Ints

MIN_GAP = 1e-3
"""Smallest relative difference of the second moments at the start: equal ones have no axes."""
DEPENDENCE_SIGMA = 1e-2
"""Standard deviation with which Aghili's dependence is enforced. A body satisfies it at no cost, so the
solution does not depend on the value; with a smaller one, steps along the curved surface are short."""

Moments = Callable[[Array], tuple[Array, Array]]
"""Parameters u (m,) -> second moments (3,) in any scale, and their derivatives (m, 3)."""


def of_log_ratios(u: Array) -> tuple[Array, Array]:
    """u = ln(Jxx / Jyy), ln(Jyy / Jzz)."""
    a, c = np.exp(u[0]), np.exp(-u[1])
    return _second(np.array([a, 1.0, c])), _second(np.array([[a, 0.0, 0.0], [0.0, 0.0, -c]]))


def of_aghili(u: Array) -> tuple[Array, Array]:
    """u = (Jyy - Jzz) / Jxx, (Jzz - Jxx) / Jyy, (Jxx - Jyy) / Jzz: A(u) J = 0 for the vector of the moments.

    det A = -(u1 + u2 + u3 + u1 u2 u3). Where it is not zero, no body has these parameters: J is then the
    singular vector of the smallest singular value, which treats the three alike.
    """
    A = np.array([[-u[0], 1.0, -1.0], [-1.0, -u[1], 1.0], [1.0, -1.0, -u[2]]])
    values, vectors = np.linalg.eigh(A.T @ A)
    J = vectors[:, 0] * np.sign(vectors[:, 0].sum())
    others = vectors[:, 1:]
    pseudo = others / (values[1:] - values[0]) @ others.T
    dJ = np.empty((3, 3))
    for i in range(3):
        dA = np.zeros((3, 3))
        dA[i, i] = -1.0
        dJ[i] = -pseudo @ (dA.T @ (A @ J) + A.T @ (dA @ J))
    return _second(J), _second(dJ)


def dependence(u: Array) -> tuple[float, Array]:
    """Zero for the parameters of a body (thesis eq. 4.92 without its quotient), and its gradient (3,)."""
    slope = np.array([1.0 + u[1] * u[2], 1.0 + u[0] * u[2], 1.0 + u[0] * u[1]])
    return float(u.sum() + u.prod()), slope


def of_lichter(u: Array) -> tuple[Array, Array]:
    """u a quaternion, scalar first, of any length: the second moments are |R(u) (0, 0, 1)| by component.

    Eqs. 4.93-4.95 add them by pairs to the moments of inertia.
    """
    a, b, c, d = u
    z = np.array([2.0 * (b * d + a * c), 2.0 * (c * d - a * b), a * a - b * b - c * c + d * d])
    dz = 2.0 * np.array([[c, -b, a], [d, -a, -b], [a, d, -c], [b, c, d]])
    return np.abs(z), dz * np.sign(z)


def _second(J: Array) -> Array:
    """Moments of inertia (..., 3) -> second moments: linear."""
    return np.asarray(0.5 * J.sum(axis=-1, keepdims=True) - J)


def log_ratios_of(second: Array) -> Array:
    """Second moments (3,) -> k1, k2."""
    J = second.sum() - second
    return np.asarray(np.log(J[:2] / J[1:]))


def aghili_of(second: Array) -> Array:
    """Second moments (3,) -> Aghili's three."""
    J = second.sum() - second
    return np.asarray((np.roll(J, -1) - np.roll(J, -2)) / J)


def lichter_of(second: Array) -> Array:
    """Second moments (3,) -> a quaternion without rotation about its own z."""
    z = second / np.linalg.norm(second)
    return np.asarray(np.array([1.0 + z[2], -z[1], z[0], 0.0]) / np.sqrt(2.0 * (1.0 + z[2])))


KINDS: dict[str, tuple[Moments, Callable[[Array], Array]]] = {
    "log_ratios": (of_log_ratios, log_ratios_of),
    "aghili": (of_aghili, aghili_of),
    "aghili_held": (of_aghili, aghili_of),
    "aghili_free": (of_aghili, aghili_of),
    "lichter": (of_lichter, lichter_of),
}


@dataclass
class ChangedInertia:
    """x(z) and its inverse; z contains u and eta where x contains xi."""

    kind: str
    problem: MeasuredProblem

    def __post_init__(self) -> None:
        self._moments, self._parameters = KINDS[self.kind]
        self._at = self.problem.fixed.reference.n_states + 3
        self.R_ref = np.eye(3)
        self._n_u = 0
        self._impossible = 0

    @property
    def of_u(self) -> slice:
        """Slots of u in z."""
        return slice(self._at, self._at + self._n_u)

    @property
    def of_eta(self) -> slice:
        """Slots of eta in z."""
        return slice(self.of_u.stop, self.of_u.stop + 3)

    def to_z(self, x: Array) -> Array:
        """z of x, with the axes of x as reference: eta is zero."""
        second = self.problem.iterate(x).second_moments(self.problem.data.form)
        values, axes = np.linalg.eigh(second)
        for i in (1, 2):
            values[i] = max(values[i], values[i - 1] * (1.0 + MIN_GAP))
        self.R_ref = axes * np.array([1.0, 1.0, np.linalg.det(axes)])
        u = self._parameters(values)
        self._n_u = len(u)
        return np.concatenate([x[: self._at], u, np.zeros(3), x[self._at + N_INERTIA :]])

    def to_x(self, z: Array) -> tuple[Array, Any]:
        """x and dx/dz (sparse); NaN where z is not that of a possible body."""
        n = self._n_u + 3
        xi, change = self._inertia(z[self.of_u], z[self.of_eta])
        after = len(z) - self._at - n
        x = np.concatenate([z[: self._at], xi, z[self._at + n :]])
        return x, block_diag([identity(self._at), csr_matrix(change), identity(after)], format="csr")

    def rows(self, z: Array) -> tuple[Array, Any]:
        """Additional residuals (k,) and their Jacobian (k, n): Aghili's dependence, or none."""
        if self.kind != "aghili_held":
            return np.zeros(0), csr_matrix((0, len(z)))
        value, slope = dependence(z[self.of_u])
        columns = np.arange(self._at, self._at + self._n_u)
        shape = (1, len(z))
        row = csr_matrix((slope, (np.zeros(3, int), columns)), shape=shape)
        return np.array([value / DEPENDENCE_SIGMA]), row / DEPENDENCE_SIGMA

    def message(self, z: Array) -> str:
        """Part of the solver's message: impossible bodies, and Aghili's dependence at the end."""
        message = f"; {self._impossible} points belonged to no possible body"
        if self.kind.startswith("aghili"):
            message += f"; the three violate their dependence by {dependence(z[self.of_u])[0]:.1e}"
        return message

    def _inertia(self, u: Array, eta: Array) -> tuple[Array, Array]:
        """xi (5,) and its derivatives (5, m + 3)."""
        d, of_u = self._moments(u)
        if not np.all(d > 0.0):
            self._impossible += 1
            return np.full(N_INERTIA, np.nan), np.full((N_INERTIA, len(u) + 3), np.nan)
        R = self.R_ref @ exp_so3(eta)
        second = R @ np.diag(d) @ R.T
        rotated = hat(right_jacobian_so3(eta).T) @ np.diag(d)
        of_eta = rotated + np.swapaxes(rotated, 1, 2)
        slopes = np.concatenate([of_u[:, :, None] * np.eye(3), of_eta])
        slopes = R @ slopes @ R.T
        # xi has determinant 1
        scale = np.cbrt(np.prod(d))
        growth = np.einsum("ij,kji->k", np.linalg.inv(second), slopes) / 3.0
        slopes = (slopes - growth[:, None, None] * second) / scale
        form, reference = self.problem.data.form, self.problem.fixed.reference
        xi = inertia_around(second, self.problem.data, reference)
        of_xi = form.derivative(xi, reference.R_inertia).reshape(N_INERTIA, 9)
        change = np.linalg.lstsq(of_xi.T, slopes.reshape(-1, 9).T, rcond=None)[0]
        return xi, np.asarray(change)


@dataclass
class AghiliDynamics:
    """Residuals of the dynamics as in Aghili's filter: his three parameters p are free in Euler's equation.

    ``w_x' = p_x w_y w_z`` and so on along the axes P (thesis eqs. 4.86-4.91). Where the three violate their
    dependence no body rotates like that: the model has a freedom that the motion lacks.
    """

    problem: MeasuredProblem
    inertia: ChangedInertia

    def __post_init__(self) -> None:
        if self.problem.fixed.reference.wrench is not None:
            raise RunFailure("Aghili's free parameters cannot be combined with a known torque")
        self._blocks = Blocks(self.problem.data, self.problem.fixed)

    def block(self, z: Array) -> Block:
        """Residuals (F - 1, 12), with derivatives in the states, com_G, p, eta."""
        at, steps = self.problem.fixed.reference, self.problem.fixed.steps
        n, s = at.n_states, at.n_state
        of_frames = z[:n].reshape(-1, s)
        states = FrameStates(
            of_frames, at.R_NG @ exp_so3(of_frames[:, 3:6]), self.problem.data.camera_N, z[n : n + 3]
        )
        p, eta = z[self.inertia.of_u], z[self.inertia.of_eta]
        propagated = propagate_in_G(
            of_frames[:-1, 9:12], p, self.inertia.R_ref, eta, steps.dt_s, steps.series
        )
        residual, jacobian = jacobians_of_propagation(states, steps, *propagated)
        first = self._blocks.step_slots()[:, : 2 * s]
        constants = np.arange(n, n + 9)
        slots = np.hstack([first, np.broadcast_to(constants, (len(first), len(constants)))])
        return Block(residual, jacobian, slots)

    def extra_cost(self, x: Array, z: Array) -> float:
        """Cost of the dynamics by z, minus that of the body nearest to it."""
        with np.errstate(over="ignore", invalid="ignore"):
            own, common = self.block(z).residual, self._blocks.dynamics(x).residual
            return 0.5 * float(np.sum(own**2) - np.sum(common**2))


def propagate_in_G(
    w_G: Array, p: Array, R_ref: Array, eta: Array, dt_s: Array, series: Ints
) -> tuple[Array, Array, Array, Array]:
    """As ``backend.dynamics.propagation``, by Aghili's p (3,) along the axes R_ref Exp(eta): Taylor series.

    Attitudes (n, 4) relative to the start, rates (n, 3) [rad/s], derivatives (n, 9, 3) of attitude error
    (right) and rate in w_G, p, eta.
    """
    R = R_ref @ exp_so3(eta)
    w_P = w_G @ R
    q, w_end, attitude, rate = propagate_in_P(w_P, p, dt_s, series)
    R_step = matrices_from_quaternions(q)
    # rows are parameters: a rotation of the axes by phi changes w_P by w_P x phi
    of_w = np.swapaxes(hat(w_P), 1, 2)
    own_attitude, own_rate = R_step - np.eye(3), np.swapaxes(-hat(w_end), 1, 2)
    Jr = right_jacobian_so3(eta)
    attitude_eta = Jr.T @ (own_attitude + of_w @ attitude[:, :3])
    rate_eta = Jr.T @ (own_rate + of_w @ rate[:, :3])
    attitude = np.concatenate([R @ attitude[:, :3], attitude[:, 3:], attitude_eta], axis=1) @ R.T
    rate = np.concatenate([R @ rate[:, :3], rate[:, 3:], rate_eta], axis=1) @ R.T
    in_G = np.concatenate([q[:, :1], q[:, 1:] @ R.T], axis=1)
    return in_G, w_end @ R.T, attitude, rate


def propagate_in_P(w_P: Array, p: Array, dt_s: Array, series: Ints) -> tuple[Array, Array, Array, Array]:
    """Attitudes (n, 4), rates (n, 3), derivatives (n, 6, 3) in w_P and p, along the axes."""
    n, m = len(dt_s), 6
    q, w = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), w_P.copy()
    attitude, rate = np.zeros((n, m, 3)), np.zeros((n, m, 3))
    rate[:, :3] = np.eye(3)
    for k in range(int(series.max(initial=0))):
        now = np.flatnonzero(series > k)
        h = dt_s[now] / series[now]
        q[now], w[now], attitude[now], rate[now] = _one_series(q[now], w[now], attitude[now], rate[now], p, h)
    return q, w, attitude, rate


def _one_series(
    q: Array, w: Array, attitude: Array, rate: Array, p: Array, h: Array
) -> tuple[Array, Array, Array, Array]:
    """Attitude, rate and their derivatives after one Taylor series of length h (n,) [s]."""
    qs, ws, attitudes, rates = [q], [w], [attitude], [rate]
    of_p = np.concatenate([np.zeros((3, 3)), np.eye(3)])
    for k in range(ORDER):
        product, of_product = np.zeros_like(w), np.zeros_like(rate)
        spin, drift = np.zeros_like(q), rates[k].copy()
        for i in range(k + 1):
            a, b = ws[i], ws[k - i]
            product += a[:, [1, 2, 0]] * b[:, [2, 0, 1]]
            da = rates[i]
            of_product += (
                da[:, :, [1, 2, 0]] * b[:, None, [2, 0, 1]] + b[:, None, [1, 2, 0]] * da[:, :, [2, 0, 1]]
            )
            spin += _quaternion_times_rate(qs[k - i], a)
            drift -= np.cross(a[:, None], attitudes[k - i])
        scale = (h / (k + 1))[:, None]
        qs.append(0.5 * scale * spin)
        ws.append(scale * p * product)
        attitudes.append(scale[:, :, None] * drift)
        rates.append(scale[:, :, None] * (of_p * product[:, None] + p * of_product))
    end, w, attitude, rate = (
        sum(reversed(terms), np.zeros_like(terms[0])) for terms in (qs, ws, attitudes, rates)
    )
    return end / np.linalg.norm(end, axis=1, keepdims=True), w, attitude, rate


def _quaternion_times_rate(q: Array, w: Array) -> Array:
    """q o (0, w), (n, 4)."""
    vector = q[:, :1] * w + np.cross(q[:, 1:], w)
    return np.concatenate([-np.sum(q[:, 1:] * w, axis=1, keepdims=True), vector], axis=1)
