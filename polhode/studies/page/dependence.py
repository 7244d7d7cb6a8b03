"""A metric along an axis: the rows in groups, and of each group its median or its share, with a band.

The band of a median is that of the bootstrap (percentiles, by SciPy), the band of a share is Wilson's: both
hold the median, or the probability, of infinitely many such points with 95 % confidence.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from polhode.geometry.lie import Array, Bools
from polhode.studies.page.columns import Axis
from polhode.studies.table import chosen_rows

BINS = 8
MIN_ROWS = 5
"""A group of fewer has no band."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Group:
    """Rows that have nearly the same value of an axis."""

    at: float
    """The value, or the median of the values"""
    rows: Bools
    """(n,)"""


@dataclass(frozen=True)
class Estimate:
    """Of a group of rows: a number with its band of 95 %."""

    at: float
    count: int
    value: float
    low: float
    """NaN: there are too few rows"""
    high: float


@dataclass(frozen=True)
class Spread:
    """Of a group of rows: the median with its band, and the range of four fifths of the rows."""

    median: Estimate
    tenth: float
    nine_tenths: float


def groups_of(axis: Axis) -> list[Group]:
    """The rows by the levels of an axis, or by ``BINS`` ranges with as many rows each."""
    levels = np.unique(axis.values)
    if axis.labels or len(levels) <= 12:
        return [Group(float(level), axis.values == level) for level in levels]
    inner = np.quantile(axis.values, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
    index = np.searchsorted(np.unique(inner), axis.values, side="right")
    found = [index == k for k in range(index.max() + 1)]
    return [Group(float(np.median(axis.values[rows])), rows) for rows in found if rows.any()]


def spreads(axis: Axis, values: Array) -> list[Spread]:
    """Median, band and range of values (n,) in each group that has any."""
    found = []
    for group in groups_of(axis):
        own = values[group.rows & np.isfinite(values)]
        own = own[chosen_rows(len(own), 1000)]
        if len(own):
            tenth, median, nine = np.quantile(own, [0.1, 0.5, 0.9]).tolist()
            estimate = Estimate(group.at, len(own), median, *bootstrap_band(own, np.median))
            found.append(Spread(estimate, tenth, nine))
    return found


def shares(axis: Axis, holds: Bools) -> list[Estimate]:
    """The share of rows (n,) in each group for which something holds."""
    found = []
    for group in groups_of(axis):
        own = holds[group.rows]
        found.append(Estimate(group.at, len(own), float(own.mean()), *share_band(int(own.sum()), len(own))))
    return found


def share_band(count: int, of: int) -> tuple[float, float]:
    """Band of a share by Wilson."""
    band = stats.binomtest(count, of).proportion_ci(CONFIDENCE, method="wilson")
    return float(band.low), float(band.high)


def bootstrap_band(values: Array, statistic: Callable[..., object]) -> tuple[float, float]:
    """Band of a statistic of values (n,); NaN for too few of them."""
    if len(values) < MIN_ROWS:
        return float("nan"), float("nan")
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    found = stats.bootstrap(
        (values,),
        statistic,
        confidence_level=CONFIDENCE,
        n_resamples=499,
        method="percentile",
        vectorized=True,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)
