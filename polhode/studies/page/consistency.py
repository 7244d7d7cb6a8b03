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
from polhode.studies.page.dependence import CONFIDENCE, bootstrap_band, share_band


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
    tail, within = 0.5 * (1.0 - CONFIDENCE), float(stats.chi2.cdf(9.0, 1))
    for group in (NEES, COVERAGE, COVERAGE_CONSTANTS):
        for name, components in COMPONENTS.items():
            values = numbers(table, f"evaluate.{group}.{name}")
            values = values[np.isfinite(values)]
            runs, band = len(values), expected_range(group, name)
            if runs < 3 or band is None:
                continue
            if group == NEES:
                low, high = (stats.chi2.ppf([tail, 1.0 - tail], runs * components) / runs).tolist()
                expected = float(components), low, high
            else:
                # as if each run had one frame, of so many components
                half = 1.96 * float(np.sqrt(within * (1.0 - within) / (runs * components)))
                expected = within, within - half, min(within + half, 1.0)
            inside = (values >= band[0]) & (values <= band[1])
            bands = float(values.mean()), *bootstrap_band(values, np.mean), *expected
            shared = float(inside.mean()), *share_band(int(inside.sum()), runs)
            found.append(Consistency(group, name, runs, *bands, *shared))
    return found
