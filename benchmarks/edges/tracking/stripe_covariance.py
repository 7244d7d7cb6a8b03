"""A covariance of the tracker of stripes that holds on bodies that it was not fitted to.

The tracker states P, of noise alone. What it does not know are edges that the model lacks: shadows beside
small plates, parts that overlap without a common edge. The image tells of them by its agreement with the
edges that are known, and what is expected of a pose tells of displacements D. So

    S = a (1 + c (1 - agreement)) P + b D

with three numbers that are fitted to known errors by maximum likelihood, under Student's distribution, so
that a pose that is wrong altogether counts little; every body counts alike. They are tested on other bodies
(benchmarks/edges/expected_errors.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.optimize import minimize

from benchmarks.edges.tracking.calibrated_covariance import nees
from polhode.lie import Array

DEGREES = 8.0
"""Of freedom of Student's distribution: between the normal one and tails without a variance"""


@dataclass(frozen=True)
class StripeErrors:
    """Known errors of n poses of one body."""

    error: Array
    """(n, 6) [m, rad]"""
    stated: Array
    """(n, 6, 6) P that the tracker states"""
    displacement: Array
    """(n, 6, 6) D, mean square of what is expected"""
    agreement: Array
    """(n,) share that the image confirms"""

    def __len__(self) -> int:
        return len(self.error)


def joined(parts: Sequence[StripeErrors]) -> StripeErrors:
    """Of several poses of a body, one at least."""
    return StripeErrors(
        *(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(StripeErrors))
    )


@dataclass(frozen=True)
class StripeCovariance:
    """What a covariance is made of."""

    noise: float
    """a"""
    displacement: float
    """b"""
    disagreement: float
    """c"""

    def of(self, known: StripeErrors) -> Array:
        """S (n, 6, 6) [m^2, m rad, rad^2]."""
        size = self.noise * (1.0 + self.disagreement * (1.0 - known.agreement))
        return np.asarray(size[:, None, None] * known.stated + self.displacement * known.displacement)


def fitted_covariance(bodies: Sequence[StripeErrors]) -> StripeCovariance:
    """The likeliest for the errors of all bodies, each of which has poses."""
    known = [_in_sigmas(each) for each in bodies]

    def loss(log_size: Array) -> float:
        tried = StripeCovariance(*(float(value) for value in np.exp(log_size)))
        return float(np.mean([_surprise(tried.of(each), each.error) for each in known]))

    start = np.zeros(3)
    simplex = np.vstack([start, start + 0.7 * np.eye(3)])
    options = {"initial_simplex": simplex, "xatol": 1e-2, "fatol": 1e-5}
    found = minimize(loss, start, method="Nelder-Mead", options=options)
    a, b, c = (float(value) for value in np.exp(found.x))
    return StripeCovariance(a, b, c)


def _surprise(covariance: Array, error: Array) -> float:
    """Mean negative logarithm of the likelihood, less a constant."""
    square = nees(error, covariance)
    tail = 0.5 * (DEGREES + 6.0) * np.log1p(square / DEGREES)
    return float(np.mean(0.5 * np.linalg.slogdet(covariance)[1] + tail))


def _in_sigmas(known: StripeErrors) -> StripeErrors:
    """In units of the stated sigmas, so that metres and radians are alike."""
    sigma = np.sqrt(np.diagonal(known.stated, axis1=1, axis2=2))
    product = sigma[:, :, None] * sigma[:, None, :]
    return StripeErrors(
        known.error / sigma, known.stated / product, known.displacement / product, known.agreement
    )
