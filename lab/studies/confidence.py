"""Numbers with intervals of 95 % for tables of findings: medians, shares, ratios, exponents.

Medians and quantiles have the interval of the order statistics (scipy.stats.quantile_test), shares that of
Clopper and Pearson: both hold for few points too, and are rather too wide. Ratios and exponents have
Student's, of logarithms that scatter as a normal distribution does.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from polhode.geometry.lie import Array

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
        return self._text(lambda value: significant(value, digits))

    def fixed(self, decimals: int = 2) -> str:
        """With so many decimals."""
        return self._text(lambda value: f"{value:.{decimals}f}")

    def _text(self, form: Callable[[float], str]) -> str:
        if math.isnan(self.value):
            return "-"
        known = math.isfinite(self.low) and math.isfinite(self.high)
        return form(self.value) + (f" ({form(self.low)} to {form(self.high)})" if known else "")


def significant(value: float, digits: int = 2) -> str:
    """A number in plain decimals; a dash for NaN."""
    if math.isnan(value):
        return "-"
    return np.format_float_positional(value, digits, unique=False, fractional=False, trim="-")


def quantile(values: Array, share: float) -> Interval:
    """The value below which a share of all such points lies; the interval is that of order statistics."""
    known = values[np.isfinite(values)]
    if not len(known):
        return Interval(0, math.nan, math.nan, math.nan)
    found = stats.quantile_test(known, p=share).confidence_interval(CONFIDENCE)
    return Interval(len(known), float(np.quantile(known, share)), float(found.low), float(found.high))


def median(values: Array) -> Interval:
    """Half of all such points are below."""
    return quantile(values, 0.5)


def share_text(count: int, of: int) -> str:
    """``9 of 10 (55% to 100%)``, with the interval of Clopper and Pearson."""
    if of == 0:
        return "0 of 0"
    found = stats.binomtest(int(count), int(of)).proportion_ci(CONFIDENCE, method="exact")
    return f"{count} of {of} ({found.low:.0%} to {found.high:.0%})"


def geometric_mean(ratios: Array) -> Interval:
    """Of ratios above 0, by their logarithms; of one ratio, without an interval."""
    known = ratios[np.isfinite(ratios) & (ratios > 0.0)]
    if not len(known):
        return Interval(0, math.nan, math.nan, math.nan)
    logs = np.log(known)
    middle, half = float(logs.mean()), math.nan
    if len(known) > 1:
        half = _student(len(known) - 1) * float(logs.std(ddof=1)) / math.sqrt(len(known))
    return Interval(len(known), math.exp(middle), math.exp(middle - half), math.exp(middle + half))


def exponents(errors: Array, by: Mapping[str, Array], groups: Sequence[object]) -> list[Interval] | None:
    """Of a product of powers of what errors (n,) depend on, each (n,) above 0.

    ``groups``: (n,) labels; each of them has a factor of its own. None: there are too few values.
    """
    columns = [np.log(values) for values in by.values()]
    columns += [np.array([each == label for each in groups], float) for label in dict.fromkeys(groups)]
    A = np.column_stack(columns)
    with np.errstate(divide="ignore", invalid="ignore"):
        y = np.log(errors)
    known = np.isfinite(y) & np.isfinite(A).all(axis=1)
    freedom = int(known.sum()) - A.shape[1]
    if freedom < 1 or np.linalg.matrix_rank(A[known]) < A.shape[1]:
        return None
    found = np.linalg.lstsq(A[known], y[known], rcond=None)[0]
    sigma = math.sqrt(float(np.sum((y[known] - A[known] @ found) ** 2)) / freedom)
    half = _student(freedom) * sigma * np.sqrt(np.diag(np.linalg.inv(A[known].T @ A[known])))
    count = int(known.sum())
    return [Interval(count, found[k], found[k] - half[k], found[k] + half[k]) for k in range(len(by))]


def _student(freedom: int) -> float:
    return float(stats.t.ppf(0.5 * (1.0 + CONFIDENCE), freedom))
