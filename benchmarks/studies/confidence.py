"""Numbers with intervals of 95 % for tables of findings: medians, shares, ratios, exponents, correlations.

Medians and quantiles have the interval of the order statistics (scipy.stats.quantile_test), shares that of
Clopper and Pearson: both hold for few points too, and are rather too wide. Ratios, exponents and correlations
have Student's and Fisher's, of logarithms or ranks that scatter as a normal distribution does.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from polhode.lie import Array

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A number with its interval; NaN: too few values."""

    count: int
    """Values that it rests on"""
    value: float
    low: float
    high: float

    def text(self, digits: int = 2) -> str:
        """With so many significant digits; a dash where there is none."""
        return self._said(lambda value: significant(value, digits))

    def fixed(self, decimals: int = 2) -> str:
        """With so many decimals."""
        return self._said(lambda value: f"{value:.{decimals}f}")

    def percent(self) -> str:
        """Of a share."""
        return self._said(lambda value: f"{value:.0%}")

    def _said(self, form: Callable[[float], str]) -> str:
        if math.isnan(self.value):
            return "-"
        known = math.isfinite(self.low) and math.isfinite(self.high)
        return form(self.value) + (f" ({form(self.low)} to {form(self.high)})" if known else "")

    def apart_from(self, value: float) -> bool:
        """Whether a value lies outside."""
        return value < self.low or value > self.high


def significant(value: float, digits: int = 2) -> str:
    """A number in plain decimals; a dash for NaN."""
    if math.isnan(value):
        return "-"
    return np.format_float_positional(value, digits, unique=False, fractional=False, trim="-")


def finite(values: Array) -> Array:
    """Those that are numbers."""
    return np.asarray(values[np.isfinite(values)])


def quantile(values: Array, share: float) -> Interval:
    """The value below which a share of all such points lies; the interval is that of order statistics."""
    known = finite(values)
    if not len(known):
        return Interval(0, math.nan, math.nan, math.nan)
    found = stats.quantile_test(known, p=share).confidence_interval(CONFIDENCE)
    return Interval(len(known), float(np.quantile(known, share)), float(found.low), float(found.high))


def median(values: Array) -> Interval:
    """Half of all such points are below."""
    return quantile(values, 0.5)


def share(count: int, of: int) -> Interval:
    """A share with the interval of Clopper and Pearson."""
    if of == 0:
        return Interval(0, math.nan, math.nan, math.nan)
    found = stats.binomtest(count, of).proportion_ci(CONFIDENCE, method="exact")
    return Interval(of, count / of, float(found.low), float(found.high))


def share_text(count: int, of: int) -> str:
    """``9 of 10 (55% to 100%)``."""
    found = share(count, of)
    return f"{count} of {of}" + (f" ({found.low:.0%} to {found.high:.0%})" if of else "")


def geometric_mean(ratios: Array) -> Interval:
    """Of ratios above 0, by their logarithms; of one ratio, without an interval."""
    known = finite(ratios)
    if not len(known):
        return Interval(0, math.nan, math.nan, math.nan)
    logs = np.log(known)
    middle, half = float(logs.mean()), math.nan
    if len(known) > 1:
        half = _student(len(known) - 1) * float(logs.std(ddof=1)) / math.sqrt(len(known))
    return Interval(len(known), math.exp(middle), math.exp(middle - half), math.exp(middle + half))


@dataclass(frozen=True)
class Powers:
    """A product of powers that was fitted to errors."""

    exponents: dict[str, Interval]
    explained: float
    """Share of the variance of the logarithm"""
    residual: Array
    """(n,) of the logarithm; NaN where a value was missing"""
    sigma: float
    """Standard deviation of the residuals"""


def powers(errors: Array, by: Mapping[str, Array], groups: Sequence[object] = ()) -> Powers | None:
    """Fit errors (n,) above 0 to a product of powers of what they depend on, each (n,) above 0.

    ``groups``: (n,) labels; each of them has a factor of its own. None: there are too few values.
    """
    columns = [np.log(values) for values in by.values()]
    labels = list(groups) or [0] * len(errors)
    columns += [np.array([each == label for each in labels], float) for label in dict.fromkeys(labels)]
    A = np.column_stack(columns)
    with np.errstate(divide="ignore", invalid="ignore"):
        y = np.log(errors)
    known = np.isfinite(y) & np.isfinite(A).all(axis=1)
    freedom = int(known.sum()) - A.shape[1]
    if freedom < 1 or np.linalg.matrix_rank(A[known]) < A.shape[1]:
        return None
    found = np.linalg.lstsq(A[known], y[known], rcond=None)[0]
    residual = np.where(known, y - A @ found, math.nan)
    sigma = math.sqrt(float(np.nansum(residual**2)) / freedom)
    spread = sigma * np.sqrt(np.diag(np.linalg.inv(A[known].T @ A[known])))
    half = _student(freedom) * spread
    count = int(known.sum())
    exponents = {
        name: Interval(count, float(found[k]), float(found[k] - half[k]), float(found[k] + half[k]))
        for k, name in enumerate(by)
    }
    explained = 1.0 - float(np.nanvar(residual) / np.var(y[known]))
    return Powers(exponents, explained, np.asarray(residual), sigma)


def _student(freedom: int) -> float:
    return float(stats.t.ppf(0.5 * (1.0 + CONFIDENCE), freedom))


def rank_correlation(first: Array, second: Array, confidence: float = CONFIDENCE) -> Interval:
    """Spearman's, with Fisher's interval of the ranks."""
    known = np.isfinite(first) & np.isfinite(second)
    a, b = first[known], second[known]
    if len(a) < 4 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return Interval(len(a), math.nan, math.nan, math.nan)
    found = stats.pearsonr(stats.rankdata(a), stats.rankdata(b))
    band = found.confidence_interval(confidence)
    return Interval(len(a), float(found.statistic), float(band.low), float(band.high))
