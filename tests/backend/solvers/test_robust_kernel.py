"""The kernel is as wide as the residuals allow: wide for Gaussian noise, narrow for heavy tails."""

import numpy as np
import pytest

from polhode.backend.solvers.robust_kernel import (
    RELATIVE_SCALES,
    efficiency,
    most_efficient_scale,
    robust_information,
)
from polhode.geometry.lie import Array


def squares(tail: float, n: int = 40_000) -> Array:
    """Squared norms of three-component residuals; a share ``tail`` of them five times as large."""
    rng = np.random.default_rng(3)
    spread = np.where(rng.random(n) < tail, 5.0, 1.0)
    s = np.sum((spread[:, None] * rng.normal(size=(n, 3))) ** 2, axis=1)
    return np.asarray(s[s < 4.5**2])


def test_gaussian_noise_gets_the_widest_kernel_and_heavier_tails_a_narrower_one() -> None:
    tails = [squares(share) for share in (0.0, 0.1, 0.3, 0.5)]
    scales = [most_efficient_scale(s, 3.0) for s in tails]
    assert scales == sorted(scales, reverse=True)
    assert scales[0] == 3.0 * max(RELATIVE_SCALES) and scales[-1] == 3.0
    assert efficiency(tails[0], scales[0]) == pytest.approx(1.0, abs=0.005)
    assert efficiency(tails[-1], 3.0) > 1.05 * efficiency(tails[-1], 15.0)
    assert np.mean(robust_information(tails[1], 3.0)) == pytest.approx(efficiency(tails[1], 3.0))


def test_efficiency_is_what_a_monte_carlo_of_the_mean_finds() -> None:
    rng, scale = np.random.default_rng(0), 2.0
    x = rng.normal(size=(4000, 200, 3))
    mean = x.mean(axis=1)
    for _ in range(20):
        w = 1.0 / (1.0 + np.sum((x - mean[:, None]) ** 2, axis=2) / scale**2)
        mean = np.einsum("kn,kni->ki", w, x) / w.sum(axis=1)[:, None]
    ratio = np.var(mean) * 200
    assert 1.0 / ratio == pytest.approx(efficiency(np.sum(x**2, axis=2).ravel(), scale), rel=0.03)
