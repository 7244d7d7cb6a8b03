"""Inertia up to scale, as five unconstrained numbers; both forms are always physical.

A mass distribution has a positive-definite matrix of second moments Sigma = integral p p^T dm, and
J = tr(Sigma) I - Sigma; every positive-definite Sigma gives a J that obeys the triangle inequality
(Rucker and Wensing, "Smooth parameterization of rigid-body inertia", 2022). det Sigma = 1 fixes the scale.
"""

from typing import Any

import casadi as ca
import numpy as np

from polhode.geometry.lie import Array, exp_so3, hat, right_jacobian_so3

N_INERTIA = 5
MIN_THICKNESS = 1e-7
"""Smallest second moment over the largest. Where the data do not bound a ratio the solver may move to ever
thinner bodies, whose smallest moment could become negative by rounding."""


class SecondMoments:
    """``xi = (l1, l2, l21, l31, l32)``: Sigma = L L^T, diag L = exp(l1, l2, -l1 - l2). Zero: a sphere."""

    name = "second_moments"

    def second_moments_sx(self, xi: Any, R_ref: Any) -> Any:
        """Sigma (3, 3) as a CasADi expression of xi (5) and R_ref (3, 3)."""
        del R_ref
        L = ca.SX.zeros(3, 3)
        L[0, 0], L[1, 1], L[2, 2] = ca.exp(xi[0]), ca.exp(xi[1]), ca.exp(-xi[0] - xi[1])
        L[1, 0], L[2, 0], L[2, 1] = xi[2], xi[3], xi[4]
        return L @ L.T

    def second_moments(self, xi: Array, R_ref: Array) -> Array:
        """Sigma (3, 3), determinant 1."""
        del R_ref
        L = np.diag(np.exp([xi[0], xi[1], -xi[0] - xi[1]]))
        L[1, 0], L[2, 0], L[2, 1] = xi[2:5]
        return np.asarray(L @ L.T)

    def derivative(self, xi: Array, R_ref: Array) -> Array:
        """d Sigma / d xi, (5, 3, 3)."""
        del R_ref
        L, dL = np.diag(np.exp([xi[0], xi[1], -xi[0] - xi[1]])), np.zeros((5, 3, 3))
        dL[0, 0, 0], dL[1, 1, 1] = L[0, 0], L[1, 1]
        dL[0, 2, 2] = dL[1, 2, 2] = -L[2, 2]
        dL[2, 1, 0] = dL[3, 2, 0] = dL[4, 2, 1] = 1.0
        L[1, 0], L[2, 0], L[2, 1] = xi[2:5]
        half = dL @ L.T
        return np.asarray(half + np.swapaxes(half, 1, 2))

    def coordinates(self, second: Array) -> tuple[Array, Array]:
        """Sigma (3, 3), any positive scale -> xi (5,), R_ref (3, 3)."""
        L = np.linalg.cholesky(unit_determinant(second))
        return np.array([np.log(L[0, 0]), np.log(L[1, 1]), L[1, 0], L[2, 0], L[2, 1]]), np.eye(3)


class RatiosAxes:
    """``xi = (a, b, eta)``: second moments d with a = ln(d1/d3), b = ln(d2/d3); axes R_ref Exp(eta)."""

    name = "ratios_axes"

    def second_moments_sx(self, xi: Any, R_ref: Any) -> Any:
        R = R_ref @ rotation_sx(xi[2:5])
        a, b = xi[0], xi[1]
        d = ca.exp(ca.vertcat((2 * a - b) / 3, (2 * b - a) / 3, -(a + b) / 3))
        return R @ ca.diag(d) @ R.T

    def second_moments(self, xi: Array, R_ref: Array) -> Array:
        R = R_ref @ exp_so3(xi[2:5])
        a, b = xi[0], xi[1]
        d = np.exp([(2 * a - b) / 3, (2 * b - a) / 3, -(a + b) / 3])
        return np.asarray(R @ np.diag(d) @ R.T)

    def derivative(self, xi: Array, R_ref: Array) -> Array:
        R = R_ref @ exp_so3(xi[2:5])
        a, b = xi[0], xi[1]
        d = np.exp([(2 * a - b) / 3, (2 * b - a) / 3, -(a + b) / 3])
        out = np.empty((5, 3, 3))
        out[0] = R @ np.diag(d * np.array([2.0, -1.0, -1.0]) / 3.0) @ R.T
        out[1] = R @ np.diag(d * np.array([-1.0, 2.0, -1.0]) / 3.0) @ R.T
        turned = hat(right_jacobian_so3(xi[2:5]).T) @ np.diag(d)
        out[2:] = R @ (turned + np.swapaxes(turned, 1, 2)) @ R.T
        return out

    def coordinates(self, second: Array) -> tuple[Array, Array]:
        d, R = np.linalg.eigh(unit_determinant(second))
        R = R * np.array([1.0, 1.0, np.linalg.det(R)])
        # at equal moments the axes have no derivative: move away from that point
        gap = 1e-3
        a, b = np.log(d[0] / d[2]), np.log(d[1] / d[2])
        b = min(b, -gap)
        a = min(a, b - gap)
        return np.array([a, b, 0.0, 0.0, 0.0]), R


InertiaForm = SecondMoments | RatiosAxes
"""Five numbers xi (5,) around a reference rotation R_ref (3, 3), which is updated between solves."""
FORMS: dict[str, InertiaForm] = {"second_moments": SecondMoments(), "ratios_axes": RatiosAxes()}


def unit_determinant(second: Array) -> Array:
    """Scale second moments (3, 3) to determinant 1; those of a needle or a disc get a thickness."""
    values, vectors = np.linalg.eigh(second)
    if values[0] < MIN_THICKNESS * values[2]:
        values = np.maximum(values, MIN_THICKNESS * values[2])
        second = (vectors * values) @ vectors.T
    return np.asarray(second / np.cbrt(np.prod(values)))


def inertia_from_second_moments(second: Array) -> Array:
    """J = tr(Sigma) I - Sigma, (3, 3)."""
    return np.asarray(np.trace(second) * np.eye(3) - second)


def inertia_derivative(form: InertiaForm, xi: Array, R_ref: Array) -> Array:
    """dJ / d xi, (5, 3, 3)."""
    second = form.derivative(xi, R_ref)
    return np.asarray(np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second)


def inertia_by_parameters(J_G: Array, form: InertiaForm) -> tuple[Array, Array]:
    """J_G (3, 3) in the scale of the solver's parameters, and its derivative (5, 3, 3) by them."""
    xi, R_ref = form.coordinates(0.5 * np.trace(J_G) * np.eye(3) - J_G)
    J = inertia_from_second_moments(form.second_moments(xi, R_ref))
    return J, inertia_derivative(form, xi, R_ref)


def second_moments_from_inertia(J: Array, floor: float = 0.02) -> Array:
    """Sigma of J (3, 3); an impossible J is projected: second moments at least ``floor`` of the largest."""
    values, vectors = np.linalg.eigh(0.5 * np.trace(J) * np.eye(3) - J)
    values = np.maximum(values, floor * values.max())
    return unit_determinant(vectors @ np.diag(values) @ vectors.T)


def principal_axes(J: Array) -> tuple[Array, Array]:
    """J (3, 3) -> moments (3,) descending with the middle one 1, and R_GP (3, 3), right-handed.

    Among the four orientations that differ by half-turns, the one is chosen in which the largest components
    of the x and z axes are positive: the same choice throughout a run.
    """
    values, vectors = np.linalg.eigh(J)
    R = vectors[:, ::-1].copy()
    for axis in (0, 2):
        R[:, axis] *= np.sign(R[np.argmax(np.abs(R[:, axis])), axis])
    R[:, 1] = np.cross(R[:, 2], R[:, 0])
    return values[::-1] / values[1], R


def quaternion_sx(theta: Any) -> Any:
    """Rotation vector -> unit quaternion, scalar first; smooth at zero. CasADi."""
    angle = ca.sqrt(ca.sumsqr(theta) + 1e-24)
    return ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) / angle * theta)


def rotation_sx(theta: Any) -> Any:
    """Rotation vector (3) -> rotation matrix (3, 3); smooth at zero. CasADi."""
    q = quaternion_sx(theta)
    w, x, y, z = q[0], q[1], q[2], q[3]
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        ca.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        ca.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
