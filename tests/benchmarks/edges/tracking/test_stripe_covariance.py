"""Covariances fitted to errors whose covariance is known."""

import numpy as np
import pytest

from benchmarks.edges.tracking.calibrated_covariance import nees
from benchmarks.edges.tracking.stripe_covariance import (
    StripeCovariance,
    StripeErrors,
    fitted_covariance,
)
from polhode.lie import Array

TRUE = StripeCovariance(noise=0.8, displacement=0.4, disagreement=9.0)
UNIT = np.array([1e-4, 2e-4, 1e-3, 1e-3, 2e-3, 5e-4])
"""of the errors [m, rad]"""


def errors_of(seed: int, count: int = 1500, sizes: tuple[float, ...] = (0.3, 3.0)) -> StripeErrors:
    """Drawn with the true covariance, of two poses that differ in what is expected."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((6, 6)) + 2.0 * np.eye(6)
    stated = np.broadcast_to(root @ root.T * np.outer(UNIT, UNIT), (count, 6, 6))
    step = rng.standard_normal(6) * UNIT
    displacement = rng.choice(sizes, count)[:, None, None] * (np.outer(step, step) + np.diag(UNIT**2))
    agreement = rng.uniform(0.8, 1.0, count)
    known = StripeErrors(np.zeros((count, 6)), stated, displacement, agreement)
    return StripeErrors(drawn(TRUE.of(known), rng), stated, displacement, agreement)


def drawn(covariance: Array, rng: np.random.Generator) -> Array:
    """Normal errors (n, 6)."""
    noise = rng.standard_normal(covariance.shape[:2])
    return np.asarray(np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), noise))


def test_the_sizes_are_found_again_and_hold_for_another_body() -> None:
    found = fitted_covariance([errors_of(1), errors_of(2), errors_of(3)])
    other = errors_of(4)
    # the tails of Student's distribution make the covariance a little smaller than that of normal errors
    assert found.noise == pytest.approx(TRUE.noise, rel=0.35)
    assert found.disagreement == pytest.approx(TRUE.disagreement, rel=0.35)
    assert 0.8 < nees(other.error, found.of(other)).mean() / 6.0 < 1.25


def test_a_pose_that_is_wrong_altogether_changes_little() -> None:
    clean = errors_of(1)
    wrong = clean.error.copy()
    wrong[::100] *= 300.0
    spoilt = StripeErrors(wrong, clean.stated, clean.displacement, clean.agreement)
    one, other = (fitted_covariance([each]) for each in (clean, spoilt))
    ratio = np.sqrt(np.trace(other.of(clean)[0]) / np.trace(one.of(clean)[0]))
    assert 1.0 < ratio < 1.25


def test_an_image_that_disagrees_tells_less() -> None:
    few = errors_of(1, count=40)
    sure = StripeErrors(few.error, few.stated, few.displacement, np.ones(40))
    assert (np.trace(TRUE.of(few)[0]) > np.trace(TRUE.of(sure)[0])).all()
