"""Tables of the trends, on errors made up to follow the metric."""

import numpy as np
import pytest

from benchmarks.edges.observability import LEVELS, levels
from benchmarks.edges.observability_tables import (
    Spot,
    by_model,
    everything,
    learned,
    nees_table,
    root_mean_squares,
    trend_table,
    trusted,
)
from benchmarks.edges.views import edge_body
from polhode.planning.edges.edge_model import edge_model


def made_up(noise_px: float = 0.05, seed: int = 0) -> list[Spot]:
    """Four bodies of two models at six poses; errors drawn from noise_px^2 C^-1, one trial in ten refused."""
    rng = np.random.default_rng(seed)
    spots = []
    for body in "abcd":
        for level in 0, 1:
            for _ in range(6):
                sigma = 10 ** rng.uniform(-3.5, -2.5, 6)
                errors = noise_px * sigma * rng.standard_normal((40, 6))
                C = np.tile(np.diag(sigma**-2), (40, 1, 1))
                support = np.ones((40, 6))
                support[::10] = 0.0
                parts = np.zeros((40, 3, 6, 6))
                parts[:, 0] = np.diag(sigma**2)
                none = np.zeros(40)
                spots.append(Spot(body, level, sigma, errors, none, support, none + noise_px, C, parts, 40))
    return spots


def test_errors_that_follow_the_metric_correlate_with_it() -> None:
    rms, sigma = root_mean_squares(made_up(), trusted)
    assert rms.shape == (48, 6)
    assert np.median(rms / sigma) == pytest.approx(0.05, rel=0.1)
    assert "0.9" in trend_table({"made up": made_up()})


def test_what_the_residual_statistic_refuses_is_left_out() -> None:
    spot = made_up()[0]
    assert everything(spot).sum() == 40 and trusted(spot).sum() == 36
    assert "10.0% lost" in trend_table({"made up": made_up()})


def test_models_are_compared_over_all_their_poses() -> None:
    rms, sigma = by_model(made_up(), everything)
    assert rms.shape == sigma.shape == (8, 6)


def test_covariances_are_tested_on_bodies_that_they_were_not_fitted_on() -> None:
    table, found, before = nees_table(made_up(), first_only=False)
    assert found.floor_px2[0] + found.slope[0] * 0.05**2 == pytest.approx(0.05**2, rel=0.1)
    assert before.floor_px2[0] == pytest.approx(0.05**2, rel=0.1)
    last = table.splitlines()[-1].split("|")
    assert float(last[3]) == pytest.approx(1.0, abs=0.05)


def test_a_regression_finds_the_feature_that_tells() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(0.0, 1.0, (400, 2))
    constant, first, second = learned(x, x[:, 0] > 0.6)
    assert first > 5.0 * abs(second) and -constant / first == pytest.approx(0.6, abs=0.1)


def test_models_of_decreasing_detail_have_their_share_of_the_edges() -> None:
    model = edge_model(edge_body("steps").mesh)
    shares = [each.lengths_m.sum() / model.lengths_m.sum() for each in levels(model)]
    assert shares[0] == pytest.approx(1.0)
    for share, wanted in zip(shares, LEVELS, strict=True):
        assert wanted <= share < wanted + 0.1 + 1e-9
