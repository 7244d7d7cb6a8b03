"""How much of a metric's variance each axis explains.

Where the points are a Saltelli design and nothing else was varied, these are Sobol indices of first order and
in total, by SALib. Otherwise they are of first order, from the means of groups: the variance between the
groups of an axis over the variance of all rows, less what chance alone would give (epsilon squared). A metric
that spans decades is taken by its logarithm.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from scipy import stats

from polhode.geometry.lie import Array, Ints
from polhode.studies.page.columns import Axis, Metric
from polhode.studies.page.dependence import CONFIDENCE, groups_of
from polhode.studies.study import OpenStudy
from polhode.studies.table import chosen_rows

RESAMPLES = 199


@dataclass(frozen=True)
class VarianceShare:
    """Of one axis in the variance of one metric."""

    first: float
    """By itself; NaN: there are too few rows"""
    low: float
    """Ends of its band of 95 %"""
    high: float
    total: float | None = None
    """With all it takes part in; None: the draws do not tell"""
    total_low: float = math.nan
    total_high: float = math.nan


@dataclass(frozen=True)
class VarianceShares:
    """Of all axes in the variance of one metric, and by what method."""

    metric: Metric
    shares: list[VarianceShare]
    is_sobol: bool


def variance_shares(study: OpenStudy, axes: Sequence[Axis], metric: Metric) -> VarianceShares:
    """Of every axis in the variance of a metric."""
    design = study.settings.design
    is_whole = len(metric.values) == study.count and len(study.factors) == 1
    if design is not None and design.method == "saltelli" and is_whole and has_salib():
        found = _sobol(list(design.settings), axes, metric)
        if found is not None:
            return VarianceShares(metric, found, True)
    return VarianceShares(metric, [_of_groups(axis, metric) for axis in axes], False)


def has_salib() -> bool:
    """Whether SALib is installed."""
    return find_spec("SALib") is not None


def _sobol(names: Sequence[str], axes: Sequence[Axis], metric: Metric) -> list[VarianceShare] | None:
    """Sobol indices of the axes; None: too few draws have all their points."""
    from SALib.analyze import sobol

    y = _transformed(metric).reshape(-1, len(names) + 2)
    y = y[np.isfinite(y).all(axis=1)]
    # of fewer draws the indices mean nothing
    if len(y) < 16 or np.ptp(y) == 0.0:
        return None
    problem = {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}
    found = sobol.analyze(problem, y.ravel(), calc_second_order=False, num_resamples=RESAMPLES, seed=0)
    shares = []
    for k in (names.index(axis.name) for axis in axes):
        first, half, total, total_half = (float(found[n][k]) for n in ("S1", "S1_conf", "ST", "ST_conf"))
        bands = first - half, first + half, total, total - total_half, total + total_half
        shares.append(VarianceShare(first, *bands))
    return shares


def _transformed(metric: Metric) -> Array:
    return np.log(metric.values) if metric.is_logarithmic else metric.values


def _of_groups(axis: Axis, metric: Metric) -> VarianceShare:
    y, group = _transformed(metric), np.zeros(len(metric.values), dtype=np.int64)
    for k, each in enumerate(groups_of(axis)):
        group[each.rows] = k
    known = np.flatnonzero(np.isfinite(y))
    # of more rows, some at random
    known = known[chosen_rows(len(known), 4000)]
    y, group = y[known], group[known]
    count = len(np.unique(group))
    if count < 2 or len(y) < 3 * count or np.ptp(y) == 0.0:
        return VarianceShare(math.nan, math.nan, math.nan)
    band = stats.bootstrap(
        (np.arange(len(y)),),
        lambda rows: between_groups(y[rows], group[rows]),
        confidence_level=CONFIDENCE,
        n_resamples=RESAMPLES,
        method="percentile",
        vectorized=False,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return VarianceShare(between_groups(y, group), max(float(band.low), 0.0), min(float(band.high), 1.0))


def between_groups(y: Array, group: Ints) -> float:
    """Epsilon squared: the share of the variance of y (n,) that lies between its groups (n,), 0..1."""
    y = y - y.mean()
    counts = np.bincount(group)
    sums = np.bincount(group, weights=y)
    there = counts > 0
    between = float((sums[there] ** 2 / counts[there]).sum())
    whole, number = float(y @ y), int(there.sum())
    if whole == 0.0 or len(y) <= number:
        return 0.0
    chance = (number - 1) * (whole - between) / (len(y) - number)
    return max((between - chance) / whole, 0.0)
