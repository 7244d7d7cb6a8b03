"""Moments and principal axes with their derivatives, and their covariance where two moments are nearly equal.

Eigenvalues repel each other: with d the difference of two moments and o the product of inertia between their
axes, the difference that is found is sqrt(d^2 + 4 o^2). Where d is small its derivative with respect to o
vanishes, while o may be known less well than d: a first-order sigma of the ratio is far too small. And two
axes that are free to rotate about the third pass its tilt from one to the other.
"""

from dataclasses import dataclass, field

import numpy as np

from polhode.backend.problem.inertia import InertiaForm, inertia_from_second_moments, principal_axes
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.wrench import TURN
from polhode.geometry.lie import Array, Bools, exp_so3, log_so3
from polhode.geometry.rigid_body import nearest_half_turn

MIN_GAP = 1e-6
"""Least difference of two moments (middle one 1) in the derivative of the axes."""
N_PAIRS = 256
"""Pairs of opposite deviations that are drawn for the covariance of the ratios."""


@dataclass(frozen=True)
class AxesDerivative:
    """Moments and axes of J_G with their derivatives in xi (delta method)."""

    moments: Array
    R_GP: Array
    ratios: Array
    """(2, 5) d(k1, k2) / d xi"""
    axes: Array
    """(3, 5) d theta / d xi, theta in R_GP Exp(theta)"""
    ln_middle: Array = field(default_factory=lambda: np.zeros(5))
    """(5,) d ln(middle moment of J of unit second moments) / d xi"""
    of_inertia: Array | None = None
    """(5, 3, 3) d J_G / d xi, the middle moment held at 1"""


def axes_derivative(form: InertiaForm, iterate: Iterate) -> AxesDerivative:
    """First-order change of moments and axes; nearly equal moments give large, finite derivatives.

    Where a known torque acts, its axes determine the choice among the half-turns.
    """
    J = iterate.J_G(form)
    moments, R = principal_axes(J)
    if iterate.wrench is not None and iterate.R_torque is not None:
        R = R @ nearest_half_turn(R, iterate.R_torque @ exp_so3(iterate.wrench[TURN]))
    values = np.diag(R.T @ J @ R)
    ratios, axes, ln_middle = np.zeros((2, 5)), np.zeros((3, 5)), np.zeros(5)
    of_inertia = np.zeros((5, 3, 3))
    step = 1e-6
    for n in range(5):
        change = np.zeros(5)
        change[n] = step
        after = inertia_from_second_moments(form.second_moments(iterate.xi + change, iterate.R_inertia))
        before = inertia_from_second_moments(form.second_moments(iterate.xi - change, iterate.R_inertia))
        M = R.T @ (after - before) @ R / (2.0 * step)
        relative = np.diag(M) / values
        ratios[:, n] = relative[0] - relative[1], relative[1] - relative[2]
        ln_middle[n] = relative[1]
        of_inertia[n] = R @ (M - relative[1] * np.diag(values)) @ R.T / values[1]
        axes[0, n] = M[2, 1] / _gap(values[1] - values[2], values[1])
        axes[1, n] = -M[0, 2] / _gap(values[0] - values[2], values[1])
        axes[2, n] = M[1, 0] / _gap(values[0] - values[1], values[1])
    return AxesDerivative(moments, R, ratios, axes, ln_middle, of_inertia)


def _gap(difference: float, middle: float) -> float:
    return max(difference, MIN_GAP * middle)


def ratio_covariance(derivative: AxesDerivative, cov_J: Array) -> Array:
    """Second moments (2, 2) of the errors of k1, k2, from the covariance (5, 5) of xi.

    Deviations of J are drawn in pairs whose second moments are exactly those of cov_J; eigenvalues are exact.
    The result equals the first-order covariance if errors are small compared with the gaps between the
    moments.
    """
    error = ratios_after(derivative, _deviations(derivative, cov_J)) - np.log(
        derivative.moments[:2] / derivative.moments[1:]
    )
    return np.asarray(error.T @ error / len(error))


def nonlinear_turns(derivative: AxesDerivative, cov_J: Array, w_P: Array, lost: Bools) -> Array:
    """Second moments (F, 6, 6) of what the first order neglects of the errors of (theta, w_P) [rad, rad/s].

    cov_J (5, 5) of xi, w_P (F, 3). Where the axes may turn by theta, the components of a rate along them
    change by |theta|^2 |w| / 2 in a direction that the first order leaves unchanged, and that may seem to be
    known much better. Turns about the axes ``lost`` (3,) are left out.
    """
    xi = _deviations(derivative, cov_J)
    linear = np.where(lost, 0.0, xi @ derivative.axes.T)
    turn = np.where(lost, 0.0, turns_after(derivative, xi))
    back = np.swapaxes(exp_so3(turn), 1, 2)
    seen = np.einsum("nij,fj->fni", back, w_P) - w_P[:, None] - np.cross(w_P[:, None], linear[None])
    rest = np.broadcast_to(turn - linear, seen.shape)
    both = np.concatenate([rest, seen], axis=2)
    return np.asarray(np.swapaxes(both, 1, 2) @ both / len(xi))


def _deviations(derivative: AxesDerivative, cov_J: Array) -> Array:
    """Pairs of opposite deviations of xi (2 N_PAIRS, 5) whose second moments are exactly cov_J (5, 5).

    Raises LinAlgError where a variance is negative: the information is singular but for rounding.
    """
    to_P = np.vstack([derivative.ratios, derivative.axes])
    covariance = to_P @ cov_J @ to_P.T
    variance = np.diag(covariance)
    if not np.all(variance >= 0.0):
        raise np.linalg.LinAlgError("the covariance of the inertia is not positive definite")
    scale = np.sqrt(variance) + 1e-300
    # one that is singular, as of a known ratio, has a factor too; unlike eigenvectors it has definite signs
    factor = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-12 * np.eye(5)) * scale[:, None]
    z = np.random.default_rng([0, 4]).normal(size=(N_PAIRS, 5))
    z = z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / N_PAIRS)).T
    in_P = np.concatenate([z, -z]) @ factor.T
    return np.asarray(np.linalg.solve(to_P, in_P.T).T)


def ratios_after(derivative: AxesDerivative, change: Array) -> Array:
    """k1, k2 (n, 2) of the inertia changed by xi (n, 5), first order in J, exact in its eigenvalues."""
    moments = np.maximum(np.linalg.eigvalsh(_changed(derivative, change))[:, ::-1], 1e-6)
    return np.asarray(np.log(moments[:, :2] / moments[:, 1:]))


def turns_after(derivative: AxesDerivative, change: Array) -> Array:
    """Turn (n, 3) [rad] of the principal axes of the inertia changed by xi (n, 5), first order in J."""
    axes = np.linalg.eigh(_changed(derivative, change))[1][:, :, ::-1]
    # each axis along its old direction, the third one to the right hand
    axes = axes * np.where(np.diagonal(axes, axis1=1, axis2=2) < 0.0, -1.0, 1.0)[:, None]
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]
    return log_so3(axes)


def _changed(derivative: AxesDerivative, change: Array) -> Array:
    """Inertia (n, 3, 3) along P, the middle moment fixed."""
    J, (a, b, c) = np.zeros((len(change), 3, 3)), derivative.moments
    dk, turn = change @ derivative.ratios.T, change @ derivative.axes.T
    # products of inertia rotate the axes, differences of moments change k
    J[:, 0, 0], J[:, 1, 1], J[:, 2, 2] = a * np.exp(dk[:, 0]), b, c * np.exp(-dk[:, 1])
    gaps = np.maximum([b - c, a - c, a - b], MIN_GAP * b)
    J[:, 2, 1] = J[:, 1, 2] = turn[:, 0] * gaps[0]
    J[:, 2, 0] = J[:, 0, 2] = -turn[:, 1] * gaps[1]
    J[:, 1, 0] = J[:, 0, 1] = turn[:, 2] * gaps[2]
    return J


def free_axis_covariance(covariance: Array, lost: Bools) -> Array:
    """Covariance (..., 3, 3) of rotations about P when only the rotation about one axis is undetermined (3,).

    The tilt of that axis may have any direction across it: the larger variance is taken for both.
    """
    if lost.sum() != 1:
        return covariance
    axis = int(np.flatnonzero(lost)[0])
    across = np.flatnonzero(~lost)
    out = np.zeros_like(covariance)
    out[..., axis, axis] = covariance[..., axis, axis]
    worst = np.linalg.eigvalsh(covariance[..., across[:, None], across])[..., -1]
    out[..., across, across] = worst[..., None]
    return out
