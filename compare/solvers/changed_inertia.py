"""The inertia as other numbers: x = x(z), where z has others in the place of xi.

``log_ratios``: the thesis's k1, k2 (eqs. 4.97-4.99). ``aghili``, ``aghili_held``: Aghili's three (eqs.
4.89-4.91), one more than there is freedom: the body is the one nearest to them, or their dependence is held
too, or they are free in the dynamics (``aghili_dynamics.py``). ``lichter``: Lichter's quaternion (eqs.
4.93-4.96), four numbers for two. Each has three more for the principal axes: R_ref Exp(eta).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, hstack, identity, vstack

from polhode.backend.problem.inertia import N_INERTIA
from polhode.compare.problem.measured_problem import MeasuredProblem, inertia_around
from polhode.lie import Array, exp_so3, hat, right_jacobian_so3

APART = 1e-3
"""Second moments nearer to each other than this share are set apart: equal ones have no axes."""
HELD = 1e-2
"""Standard deviation of Aghili's dependence where it is held. It costs nothing to obey, so that it holds in
the end whatever this is; held more firmly, steps creep along the curved surface."""

Moments = Callable[[Array], tuple[Array, Array]]
"""Numbers u (m,) -> second moments (3,) in any scale, and their derivatives (m, 3)."""


def of_log_ratios(u: Array) -> tuple[Array, Array]:
    """u = ln(Jxx / Jyy), ln(Jyy / Jzz)."""
    a, c = np.exp(u[0]), np.exp(-u[1])
    return _second(np.array([a, 1.0, c])), _second(np.array([[a, 0.0, 0.0], [0.0, 0.0, -c]]))


def of_aghili(u: Array) -> tuple[Array, Array]:
    """u = (Jyy - Jzz) / Jxx, (Jzz - Jxx) / Jyy, (Jxx - Jyy) / Jzz: A(u) J = 0 for the vector of the moments.

    det A = -(u1 + u2 + u3 + u1 u2 u3). Off that surface no body has these numbers: J is the singular vector
    of the smallest singular value then, which treats the three alike.
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
    """Zero for the numbers of a body (thesis eq. 4.92 without its quotient), and its gradient (3,)."""
    slope = np.array([1.0 + u[1] * u[2], 1.0 + u[0] * u[2], 1.0 + u[0] * u[1]])
    return float(u.sum() + u.prod()), slope


def of_lichter(u: Array) -> tuple[Array, Array]:
    """u a quaternion, scalar first, of any length: the second moments are the sizes of R(u) (0, 0, 1).

    Eq. 4.93-4.95 add them by pairs to the moments of inertia.
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
    """Second moments (3,) -> a quaternion without a turn about its own z."""
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
    """x(z) and back. z holds the numbers u and eta where x holds xi."""

    kind: str
    problem: MeasuredProblem

    def __post_init__(self) -> None:
        self._moments, self._numbers = KINDS[self.kind]
        self._at = self.problem.held.reference.n_states + 3
        self.R_ref = np.eye(3)
        self._n_u = 0
        self._impossible = 0

    @property
    def of_u(self) -> slice:
        """Where z holds u."""
        return slice(self._at, self._at + self._n_u)

    @property
    def of_eta(self) -> slice:
        """Where z holds eta."""
        return slice(self.of_u.stop, self.of_u.stop + 3)

    def to_z(self, x: Array) -> Array:
        """Axes and moments anew from x: eta is zero then."""
        second = self.problem.iterate(x).second_moments(self.problem.data.form)
        values, axes = np.linalg.eigh(second)
        for i in (1, 2):
            values[i] = max(values[i], values[i - 1] * (1.0 + APART))
        self.R_ref = axes * np.array([1.0, 1.0, np.linalg.det(axes)])
        u = self._numbers(values)
        self._n_u = len(u)
        return np.concatenate([x[: self._at], u, np.zeros(3), x[self._at + N_INERTIA :]])

    def to_x(self, z: Array) -> tuple[Array, Any]:
        """x and dx/dz (sparse); not numbers where z is no possible body's."""
        n = self._n_u + 3
        xi, change = self._inertia(z[self.of_u], z[self.of_eta])
        rest = len(z) - self._at - n
        x = np.concatenate([z[: self._at], xi, z[self._at + n :]])
        before, after = identity(self._at, format="csr"), identity(rest, format="csr")
        none, small = csr_matrix((self._at, n + rest)), csr_matrix((N_INERTIA, self._at))
        middle = hstack([small, csr_matrix(change), csr_matrix((N_INERTIA, rest))])
        rows = [hstack([before, none]), middle, hstack([csr_matrix((rest, self._at + n)), after])]
        return x, vstack(rows, format="csr")

    def rows(self, z: Array) -> tuple[Array, Any]:
        """Residuals (k,) and Jacobian (k, n) beside the common cost: Aghili's dependence, or none."""
        if self.kind != "aghili_held":
            return np.zeros(0), csr_matrix((0, len(z)))
        value, slope = dependence(z[self.of_u])
        columns = np.arange(self._at, self._at + self._n_u)
        shape = (1, len(z))
        return np.array([value / HELD]), csr_matrix((slope / HELD, (np.zeros(3, int), columns)), shape=shape)

    def words(self, z: Array) -> str:
        """What there is to say of the numbers at the end."""
        told = f"{self._impossible} points were no possible body's"
        if self.kind.startswith("aghili"):
            told += f"; the three are off their dependence by {dependence(z[self.of_u])[0]:.1e}"
        return told

    def _inertia(self, u: Array, eta: Array) -> tuple[Array, Array]:
        """xi (5,) and its derivatives (5, m + 3)."""
        d, of_u = self._moments(u)
        if not np.all(d > 0.0):
            self._impossible += 1
            return np.full(N_INERTIA, np.nan), np.full((N_INERTIA, len(u) + 3), np.nan)
        R = self.R_ref @ exp_so3(eta)
        second = R @ np.diag(d) @ R.T
        turned = hat(right_jacobian_so3(eta).T) @ np.diag(d)
        of_eta = turned + np.swapaxes(turned, 1, 2)
        slopes = np.concatenate([of_u[:, :, None] * np.eye(3), of_eta])
        slopes = R @ slopes @ R.T
        # xi has determinant 1
        scale = np.cbrt(np.prod(d))
        growth = np.einsum("ij,kji->k", np.linalg.inv(second), slopes) / 3.0
        slopes = (slopes - growth[:, None, None] * second) / scale
        form, reference = self.problem.data.form, self.problem.held.reference
        xi = inertia_around(second, self.problem.data, reference)
        of_xi = form.derivative(xi, reference.R_inertia).reshape(N_INERTIA, 9)
        change = np.linalg.lstsq(of_xi.T, slopes.reshape(-1, 9).T, rcond=None)[0]
        return xi, np.asarray(change)
