"""A covariance of the tracked pose that holds: C^-1 alone counts every control point as a witness of its own.

Noise along an edge is not independent: blur, shading and errors of the model displace a whole edge, and a
limb against the sky moves outward all around with exposure. With weights W (m, m) in the fit, an error n of
the m distances moves the pose by C^-1 F^T W n, so for noise of three kinds

    cov = C^-1 (a own + b shared + c limb) C^-1
    own = sum_i w_i^2 f_i f_i^T        each point by itself
    shared = sum_e g_e g_e^T           an edge as a whole, g_e = sum of w_i f_i over its points
    limb = h h^T                       all limbs outward together, h = sum of w_i s_i f_i, s_i the polarity

with variances a, b, c [px^2], each a constant plus a share of the image's own mean squared residual. They are
fitted to known errors by maximum likelihood (`fitted`), on some models, and tested on others
(benchmarks/edges/observability.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from benchmarks.edges.tracking.tracker import TrackingResult, polarity
from polhode.lie import Array
from polhode.records import Ints

KINDS = ("own", "shared", "limb")


@dataclass(frozen=True)
class NoiseParts:
    """What a unit variance of each kind of noise makes of the pose, for n fits."""

    parts: Array
    """(n, 3, 6, 6) covariances for one px^2 of each of KINDS"""
    residual_px: Array
    """(n,) root mean square of the residuals; 0 before there is an image"""


@dataclass(frozen=True)
class EdgeNoise:
    """Variances of the three kinds: floor + slope * residual_px^2."""

    floor_px2: tuple[float, float, float]
    slope: tuple[float, float, float]

    def covariance(self, noise: NoiseParts) -> Array:
        """(n, 6, 6) [m^2, m rad, rad^2]."""
        variance = np.array(self.floor_px2) + np.array(self.slope) * noise.residual_px[:, None] ** 2
        return np.asarray(np.einsum("nk,nkij->nij", variance, noise.parts))


LEVELS = EdgeNoise((0.0, 0.0, 0.0), (1.45, 0.0, 0.0))
"""Of all plain bodies together, as benchmarks.observability prints them: on those images nothing is
common to an edge."""


def noise_parts(f: Array, weight: Array, feature: Ints, sign: Ints) -> Array:
    """(3, 6, 6) of one fit: f (m, 6), weights (m,), edge and polarity (m,). C must have full rank.

    Raises numpy.linalg.LinAlgError where it has not.
    """
    weighted = f * weight[:, None]
    inverse = np.linalg.inv(weighted.T @ f)
    _, edge = np.unique(feature, return_inverse=True)
    of_edge = np.zeros((int(edge.max()) + 1, 6))
    np.add.at(of_edge, edge, weighted)
    h = (weighted * sign[:, None]).sum(axis=0)
    inner = np.stack([weighted.T @ weighted, of_edge.T @ of_edge, np.outer(h, h)])
    return np.asarray(inverse @ inner @ inverse)


def parts_of(tracked: TrackingResult) -> NoiseParts:
    """Of a tracked pose whose six degrees of freedom are all seen."""
    weight = tracked.points.weight * tracked.robust
    sign = polarity(tracked.beside)
    parts = noise_parts(tracked.f, weight, tracked.points.feature, sign)
    return NoiseParts(parts[None], np.array([tracked.sigma_px]))


def fitted(noise: NoiseParts, errors: Array, with_image: bool = True) -> EdgeNoise:
    """Variances of greatest likelihood for errors (n, 6); without slopes if not ``with_image``."""
    scale = np.sqrt(np.median(errors**2, axis=0))
    parts = noise.parts / np.outer(scale, scale)
    e = errors / scale
    count = 6 if with_image else 3
    basis = np.hstack([np.ones((len(e), 3)), np.repeat(noise.residual_px[:, None] ** 2, 3, axis=1)])[
        :, :count
    ]
    kinds = np.concatenate([parts, parts], axis=1)[:, :count]

    def loss(log_variance: Array) -> tuple[float, Array]:
        size = basis * np.exp(log_variance)
        covariance = np.einsum("nk,nkij->nij", size, kinds)
        inverse = np.linalg.inv(covariance)
        pulled = np.einsum("nij,nj->ni", inverse, e)
        value = 0.5 * np.mean(np.linalg.slogdet(covariance)[1] + np.einsum("ni,ni->n", e, pulled))
        by_trace = np.einsum("nij,nkji->nk", inverse, kinds)
        by_error = np.einsum("ni,nkij,nj->nk", pulled, kinds, pulled)
        return float(value), np.asarray(0.5 * np.mean(size * (by_trace - by_error), axis=0))

    start = np.log(np.full(count, 1e-3))
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(-23.0, 5.0)] * count)
    variance = np.exp(found.x)
    slope = variance[3:] if with_image else np.zeros(3)
    return EdgeNoise(_triple(variance[:3]), _triple(slope))


def nees(errors: Array, covariance: Array) -> Array:
    """Normalised squared errors (n,): 6 in the mean where covariances (n, 6, 6) are honest."""
    solved = np.linalg.solve(covariance, errors[..., None])[..., 0]
    return np.asarray(np.einsum("ni,ni->n", errors, solved))


def _triple(values: Sequence[float] | Array) -> tuple[float, float, float]:
    a, b, c = (float(value) for value in values)
    return a, b, c
