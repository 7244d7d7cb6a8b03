"""A metric along an axis: the rows in groups; of each its median or share, and the variance between them.

The band of a median is that of the bootstrap (percentiles, by SciPy), the band of a share is Wilson's: both
hold the median, or the probability, of infinitely many such points with 95 % confidence. The share of the
variance that an axis explains is that between its groups over that of all rows, less what chance alone would
give (epsilon squared).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from polhode.geometry.lie import Array, Bools, Ints
from polhode.studies.page.columns import Axis, Metric
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


def bootstrap_band(
    values: Array | Ints, statistic: Callable[..., object], resamples: int = 499, vectorized: bool = True
) -> tuple[float, float]:
    """Band of a statistic of values (n,); NaN for too few of them."""
    if len(values) < MIN_ROWS:
        return math.nan, math.nan
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    found = stats.bootstrap(
        (values,),
        statistic,
        confidence_level=CONFIDENCE,
        n_resamples=resamples,
        method="percentile",
        vectorized=vectorized,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)


def variance_share(axis: Axis, metric: Metric) -> tuple[float, float, float]:
    """The share of a metric's variance that an axis explains, and its band; NaN: there are too few rows.

    A metric that spans decades is taken by its logarithm.
    """
    y = np.log(metric.values) if metric.is_logarithmic else metric.values
    group = np.zeros(len(y), dtype=np.int64)
    for k, each in enumerate(groups_of(axis)):
        group[each.rows] = k
    known = np.flatnonzero(np.isfinite(y))
    # of more rows, some at random
    known = known[chosen_rows(len(known), 4000)]
    y, group = y[known], group[known]
    count = len(np.unique(group))
    if count < 2 or len(y) < 3 * count or np.ptp(y) == 0.0:
        return math.nan, math.nan, math.nan
    low, high = bootstrap_band(
        np.arange(len(y)), lambda rows: between_groups(y[rows], group[rows]), 199, vectorized=False
    )
    return between_groups(y, group), max(low, 0.0), min(high, 1.0)


def between_groups(y: Array, group: Ints) -> float:
    """Epsilon squared: the share of the variance of y (n,) that lies between its groups (n,), 0..1."""
    y = y - y.mean()
    counts, sums = np.bincount(group), np.bincount(group, weights=y)
    there = counts > 0
    between = float((sums[there] ** 2 / counts[there]).sum())
    whole, number = float(y @ y), int(there.sum())
    if whole == 0.0 or len(y) <= number:
        return 0.0
    chance = (number - 1) * (whole - between) / (len(y) - number)
    return max((between - chance) / whole, 0.0)
