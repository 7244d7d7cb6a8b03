"""Groups of an axis, their medians, shares and variance, and the bands of these."""

from typing import Any

import numpy as np
import pytest

from polhode.studies.page.columns import Axis, Metric
from polhode.studies.page.dependence import (
    BINS,
    MIN_ROWS,
    between_groups,
    bootstrap_band,
    groups_of,
    share_band,
    shares,
    spreads,
    variance_share,
)


def test_few_levels_are_groups_and_many_numbers_are_binned_with_as_many_rows_each() -> None:
    few = groups_of(Axis("a", np.array([2.0, 1.0, 2.0, 1.0, 3.0])))
    assert [(each.at, int(each.rows.sum())) for each in few] == [(1.0, 2), (2.0, 2), (3.0, 1)]
    many = groups_of(Axis("a", np.random.default_rng(1).exponential(size=400)))
    assert [int(each.rows.sum()) for each in many] == [400 // BINS] * BINS
    assert np.sum([each.rows for each in many], axis=0).tolist() == [1] * 400
    assert len(groups_of(Axis("a", np.arange(20.0), labels=tuple("abcdefghijklmnopqrst")))) == 20


@pytest.mark.parametrize("statistic", [np.median, np.mean])
def test_the_band_holds_the_truth_in_95_of_100_cases(statistic: Any) -> None:
    rng = np.random.default_rng(3)
    bands = [bootstrap_band(rng.normal(5.0, 2.0, 40), statistic) for _ in range(200)]
    # a binomial of 200 with 0.95 has less than 0.89 in one of 1000 cases
    assert 0.89 <= np.mean([low <= 5.0 <= high for low, high in bands]) <= 1.0
    # a group of few rows has no band, and one of equal rows a point
    assert np.isnan(bootstrap_band(np.arange(MIN_ROWS - 1.0), statistic)).all()
    assert bootstrap_band(np.full(20, 3.0), statistic) == (3.0, 3.0)


def test_medians_leave_out_what_is_unknown_and_shares_have_the_band_of_wilson() -> None:
    axis = Axis("a", np.repeat([1.0, 2.0, 3.0], 50))
    values = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(10.0, 20.0, 50), np.full(50, np.nan)])
    values[0] = np.nan
    found = spreads(axis, values)
    assert [each.median.count for each in found] == [49, 50]
    second = found[1]
    assert (second.tenth, second.median.value, second.nine_tenths) == pytest.approx((11.0, 15.0, 19.0))
    assert 11.0 < second.median.low < 15.0 < second.median.high < 19.0
    share = shares(
        Axis("a", np.repeat([0.0, 1.0], 10), labels=("x", "y")), np.array([True] * 10 + [True, False] * 5)
    )
    assert [(each.value, each.count) for each in share] == [(1.0, 10), (0.5, 10)]
    # Wilson's band for 10 of 10, by hand: n / (n + z^2)
    assert share[0].low == pytest.approx(10 / (10 + 1.959964**2)) and share[0].high == pytest.approx(1.0)
    assert share_band(5, 10) == (share[1].low, share[1].high)


def test_shares_of_the_variance_of_a_known_function_are_found() -> None:
    rng = np.random.default_rng(5)
    x, y, z = rng.uniform(-0.5, 0.5, (3, 600))
    # variances of uniform draws of width 1: 1/12 each; of their product: 1/144
    metric = Metric("evaluate.e", 2.0 * x + y + 12.0**0.5 * x * z)
    for drawn, first in zip((x, y, z), (4 / 6, 1 / 6, 0.0), strict=True):
        share, low, high = variance_share(Axis("a", drawn), metric)
        # bins of an eighth of the range leave out 1/64 of the variance of a line
        assert share == pytest.approx(first, abs=0.06) and low <= share <= high
    assert np.isnan(variance_share(Axis("a", np.array([0.1, 0.2])), Metric("e", np.array([1.0, 2.0])))[0])
    # without the correction for chance, noise alone would have 4 / 199 on average
    group = np.repeat(np.arange(5), 40)
    assert np.mean([between_groups(rng.normal(size=200), group) for _ in range(200)]) < 0.012
    assert between_groups(group.astype(float), group) == pytest.approx(1.0)
