"""What every solver is measured by."""

import numpy as np
import pytest

from polhode.compare.problem.assessment import assess
from polhode.compare.problem.measured_problem import MeasuredProblem


def test_the_decrease_that_is_left_counts_the_landmarks(small: MeasuredProblem) -> None:
    x = small.solution.copy()
    first = small.fixed.reference.n_dense
    x[first:] += 1e-4 * np.random.default_rng(0).normal(size=len(x) - first)
    moved, least = assess(small, x), assess(small, small.solution)
    assert moved.cost is not None and least.cost is not None and moved.gain_left is not None
    assert least.gain_left is not None and least.gain_left < 1e-6
    assert moved.gain_left * moved.cost == pytest.approx(moved.cost - least.cost, rel=0.1)
