"""Bounds of tails against distributions whose tails are known."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import norm, t

from polhode.planning.keep_out.score_tail import ScoreTail


@pytest.mark.parametrize(("law", "most"), [(norm, 1.6), (t(4), 3.5)], ids=["Gaussian errors", "long tails"])
@pytest.mark.parametrize(("count", "miss"), [(60, 9e-3), (400, 9e-3), (400, 9e-4), (1200, 9e-5)])
def test_a_bound_is_exceeded_as_often_as_is_said(law: Any, most: float, count: int, miss: float) -> None:
    rng = np.random.default_rng(3)
    draws = law.rvs(size=(40, count), random_state=rng)
    tails = [ScoreTail.of(each) for each in draws]
    bounds = np.array([tail.bound(miss) for tail in tails])
    realised = law.sf(bounds)
    assert realised.mean() < most * miss
    # nor far beyond what is needed, and as uncertain as is said
    true = law.isf(miss)
    assert 0.85 * true < np.median(bounds) < 1.6 * true
    stated = np.median([tail.sigma(miss) for tail in tails])
    assert 0.3 * stated < bounds.std() < 2.0 * stated + 0.1
    for tail, bound in zip(tails[:3], bounds[:3], strict=True):
        assert tail.exceeded(bound) == pytest.approx(miss, rel=0.35)


def test_many_draws_give_an_order_statistic_and_equal_ones_themselves() -> None:
    scores = np.arange(1.0, 2000.0)[::-1]
    tail = ScoreTail.of(scores)
    assert tail.bound(0.05) == 1900.0 and tail.sigma(0.05) == pytest.approx(np.sqrt(0.05 * 1999.0), rel=0.01)
    assert tail.exceeded(1000.5) == pytest.approx(0.5, abs=1e-3)
    same = ScoreTail.of(np.full(100, 0.3))
    assert same.bound(1e-3) == pytest.approx(0.3, abs=1e-6) and same.exceeded(0.4) < 1e-6
    bounds = [tail.bound(miss) for miss in (0.2, 1e-2, 1e-3, 1e-4)]
    assert bounds == sorted(bounds)
