"""Covariance of ratios and axes where two moments are nearly equal and the delta method fails.

Eigenvalues repel each other: with d the difference of two moments and o the product of inertia between their
axes, the difference found is sqrt(d^2 + 4 o^2). Where d is small its derivative by o vanishes, while o may be
known worse than d: a first-order sigma of the ratio is far too small. And two axes that are free to turn
about the third carry its tilt from one to the other.
"""

import numpy as np

from polhode.backend.uncertainty.covariance import SMALLEST_GAP, AxesDerivative
from polhode.lie import Array
from polhode.records import Bools

PAIRS = 256


def ratio_covariance(derivative: AxesDerivative, cov_J: Array) -> Array:
    """Second moments (2, 2) of the errors of k1, k2, from the covariance (5, 5) of xi.

    Deviations of J are drawn in pairs whose second moments are exactly those of cov_J; eigenvalues are exact.
    The first-order covariance while errors are small against the gaps between the moments.
    """
    values, vectors = np.linalg.eigh(cov_J)
    z = np.random.default_rng([0, 4]).normal(size=(PAIRS, 5))
    z = z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / PAIRS)).T
    xi = np.concatenate([z, -z]) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    error = ratios_after(derivative, xi) - np.log(derivative.moments[:2] / derivative.moments[1:])
    return np.asarray(error.T @ error / len(error))


def ratios_after(derivative: AxesDerivative, change: Array) -> Array:
    """k1, k2 (n, 2) of the inertia changed by xi (n, 5), first order in J, exact in its eigenvalues."""
    J, (a, b, c) = np.zeros((len(change), 3, 3)), derivative.moments
    dk, turn = change @ derivative.ratios.T, change @ derivative.axes.T
    # along P, the middle moment held: the products of inertia that turn the axes, the differences that are k
    J[:, 0, 0], J[:, 1, 1], J[:, 2, 2] = a * np.exp(dk[:, 0]), b, c * np.exp(-dk[:, 1])
    gaps = np.maximum([b - c, a - c, a - b], SMALLEST_GAP * b)
    J[:, 2, 1] = J[:, 1, 2] = turn[:, 0] * gaps[0]
    J[:, 2, 0] = J[:, 0, 2] = -turn[:, 1] * gaps[1]
    J[:, 1, 0] = J[:, 0, 1] = turn[:, 2] * gaps[2]
    moments = np.maximum(np.linalg.eigvalsh(J)[:, ::-1], 1e-6)
    return np.asarray(np.log(moments[:, :2] / moments[:, 1:]))


def of_free_turn(covariance: Array, lost: Bools) -> Array:
    """Covariance (..., 3, 3) of rotations about P when only the turn about one axis is lost (3,).

    The tilt of that axis may lie in any direction across it: the worse one counts for both.
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
