"""Posterior of the levels from an evidence in closed form, against quadrature."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.linalg import LinAlgError

from polhode.backend.outliers_and_noise.level_posterior import posterior
from polhode.backend.problem.level_prior import LevelPrior

PRIOR = LevelPrior((1e-6, 1e-7), 2.0)
Evidence = Callable[[Any], Any]


def of_samples(count: int, psd: float, noise: float = 0.0) -> Evidence:
    """Minus the log-evidence of a power q from ``count`` squares of Gaussians of variance q + noise."""
    return lambda q: 0.5 * count * (np.log(q + noise) + (psd + noise) / (q + noise))


def by_quadrature(evidence: Evidence, stated: float) -> tuple[float, float]:
    """Mean of the power, and standard deviation of its logarithm [decades]."""
    x = np.linspace(-14.0, 4.0, 40_001)
    cost = evidence(stated * 10.0**x) + 0.5 * (x / 2.0 + 1.0) ** 2
    density = np.exp(cost.min() - cost)
    density /= simpson(density, x=x)
    mean = simpson(density * x, x=x)
    spread = np.sqrt(simpson(density * (x - mean) ** 2, x=x))
    return float(simpson(density * stated * 10.0**x, x=x)), float(spread)


@pytest.mark.parametrize("evidences", [
    (of_samples(300, 3e-9), of_samples(20, 1e-6)),
    (of_samples(60, 0.0, 1e-9), of_samples(12, 2e-9, 1e-8)),
    (of_samples(6, 3e-6), of_samples(200, 1e-11, 1e-8)),
], ids=["resolved", "hardly resolved", "few and many"])  # fmt: skip
def test_moments_are_those_of_quadrature(evidences: tuple[Evidence, Evidence]) -> None:
    found = posterior(PRIOR, lambda accel, torque: evidences[0](accel) + evidences[1](torque))
    for evidence, stated, psd, decades in zip(evidences, PRIOR.stated, *found, strict=True):
        mean, spread = by_quadrature(evidence, stated)
        assert np.log10(psd / mean) == pytest.approx(0.0, abs=0.04)
        assert decades == pytest.approx(spread, rel=0.05)


def test_without_data_the_posterior_is_the_prior() -> None:
    narrow = LevelPrior((1e-6, 1e-6), 0.5)
    found = posterior(narrow, lambda accel, torque: 0.0)
    assert found.decades == pytest.approx((0.5, 0.5), rel=0.02)
    # the mean of a log-normal power over its median
    assert found.psd[0] == pytest.approx(
        1e-6 * 10.0**-0.5 * np.exp(0.5 * (0.5 * np.log(10.0)) ** 2), rel=0.05
    )


def test_nothing_that_fits_is_an_error() -> None:
    with pytest.raises(LinAlgError, match="no level"):
        posterior(PRIOR, lambda accel, torque: np.inf)
