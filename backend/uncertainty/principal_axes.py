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
from polhode.lie import Array, exp_so3
from polhode.records import Bools
from polhode.rigid_body import nearest_half_turn

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
        axes[0, n] = M[2, 1] / _gap(values[1] - values[2], values[1])
        axes[1, n] = -M[0, 2] / _gap(values[0] - values[2], values[1])
        axes[2, n] = M[1, 0] / _gap(values[0] - values[1], values[1])
    return AxesDerivative(moments, R, ratios, axes, ln_middle)


def _gap(difference: float, middle: float) -> float:
    return max(difference, MIN_GAP * middle)


def ratio_covariance(derivative: AxesDerivative, cov_J: Array) -> Array:
    """Second moments (2, 2) of the errors of k1, k2, from the covariance (5, 5) of xi.

    Deviations of J are drawn in pairs whose second moments are exactly those of cov_J; eigenvalues are exact.
    The result equals the first-order covariance if errors are small compared with the gaps between the
    moments.
    """
    values, vectors = np.linalg.eigh(cov_J)
    z = np.random.default_rng([0, 4]).normal(size=(N_PAIRS, 5))
    z = z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / N_PAIRS)).T
    xi = np.concatenate([z, -z]) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    error = ratios_after(derivative, xi) - np.log(derivative.moments[:2] / derivative.moments[1:])
    return np.asarray(error.T @ error / len(error))


def ratios_after(derivative: AxesDerivative, change: Array) -> Array:
    """k1, k2 (n, 2) of the inertia changed by xi (n, 5), first order in J, exact in its eigenvalues."""
    J, (a, b, c) = np.zeros((len(change), 3, 3)), derivative.moments
    dk, turn = change @ derivative.ratios.T, change @ derivative.axes.T
    # along P, the middle moment fixed: products of inertia rotate the axes, differences of moments change k
    J[:, 0, 0], J[:, 1, 1], J[:, 2, 2] = a * np.exp(dk[:, 0]), b, c * np.exp(-dk[:, 1])
    gaps = np.maximum([b - c, a - c, a - b], MIN_GAP * b)
    J[:, 2, 1] = J[:, 1, 2] = turn[:, 0] * gaps[0]
    J[:, 2, 0] = J[:, 0, 2] = -turn[:, 1] * gaps[1]
    J[:, 1, 0] = J[:, 0, 1] = turn[:, 2] * gaps[2]
    moments = np.maximum(np.linalg.eigvalsh(J)[:, ::-1], 1e-6)
    return np.asarray(np.log(moments[:, :2] / moments[:, 1:]))


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
