"""Whether the errors of all points agree with the standard deviations that the runs state.

A normalised squared error (NEES) of n components is n on average, and three standard deviations hold 99.7 %
of the components. The frames of a run depend on one another, so that a run counts once: the expected band of
the mean over N runs is that of a chi-squared distribution of N n degrees of freedom over N.
"""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from scipy import stats

from polhode.records.metrics import COMPONENTS, COVERAGE, COVERAGE_CONSTANTS, NEES, expected_range
from polhode.studies.page.columns import numbers
from polhode.studies.page.dependence import CONFIDENCE, mean_band, share_band

GAUSSIAN_3_SIGMA = float(stats.chi2.cdf(9.0, 1))


@dataclass(frozen=True)
class Consistency:
    """Of one quantity, over the runs that have it."""

    group: str
    """NEES or coverage"""
    name: str
    runs: int
    mean: float
    low: float
    """Ends of the band of the mean, by the bootstrap"""
    high: float
    expected: float
    expected_low: float
    """Ends of where the mean lies in 95 of 100 studies if the standard deviations are right"""
    expected_high: float
    inside: float
    """Share of the runs inside the band of a single run, with its own band"""
    inside_low: float
    inside_high: float

    @property
    def sigmas(self) -> str:
        """What the bands say of the standard deviations: right (they overlap), too small, or too large."""
        above, below = self.low > self.expected_high, self.high < self.expected_low
        if not (above or below):
            return "right"
        return "too small" if above == (self.group == NEES) else "too large"


def consistencies(table: pa.Table) -> list[Consistency]:
    """Of all quantities that were evaluated in some runs."""
    found = []
    for group in (NEES, COVERAGE, COVERAGE_CONSTANTS):
        for name, components in COMPONENTS.items():
            values = numbers(table, f"evaluate.{group}.{name}")
            values = values[np.isfinite(values)]
            if len(values) >= 3:
                found.append(_consistency(group, name, components, values))
    return found


def _consistency(group: str, name: str, components: int, values: np.ndarray) -> Consistency:
    runs, band = len(values), expected_range(group, name)
    assert band is not None
    expected: tuple[float, float, float]
    if group == NEES:
        tail = 0.5 * (1.0 - CONFIDENCE)
        low, high = stats.chi2.ppf([tail, 1.0 - tail], runs * components) / runs
        expected = (float(components), float(low), float(high))
    else:
        # as if each run had one frame, of so many components
        half = 1.96 * np.sqrt(GAUSSIAN_3_SIGMA * (1.0 - GAUSSIAN_3_SIGMA) / (runs * components))
        expected = (GAUSSIAN_3_SIGMA, GAUSSIAN_3_SIGMA - half, min(GAUSSIAN_3_SIGMA + half, 1.0))
    inside = (values >= band[0]) & (values <= band[1])
    return Consistency(
        group,
        name,
        runs,
        float(values.mean()),
        *mean_band(values),
        *expected,
        float(inside.mean()),
        *share_band(int(inside.sum()), runs),
    )
