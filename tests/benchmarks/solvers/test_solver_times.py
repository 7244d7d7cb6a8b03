"""Both solvers are timed on the way to one optimum; exponents are slopes; the picture is drawn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.solvers.backend_size import THESIS, Times, draw_growth, exponent, measure

SMALL = replace(THESIS, frames=10, landmarks=150)


def test_the_exponent_of_a_power_is_the_power() -> None:
    sizes = np.array([10.0, 30.0, 100.0])
    assert exponent(sizes, 3e-3 * sizes**2.5) == pytest.approx(2.5)


def test_both_solvers_are_timed_on_the_way_to_the_same_cost() -> None:
    times = measure(SMALL)
    assert times.frames == 10 and times.landmarks <= 150
    assert times.costs[0] == pytest.approx(times.costs[1], rel=1e-7)
    assert min(times.gauss_newton_s, times.ipopt_s, times.build_s, times.covariance_s) > 0.0
    assert 1 < times.gauss_newton_iterations < 60 and 1 < times.ipopt_iterations < 60


def test_the_growth_is_drawn(tmp_path: Path) -> None:
    rows = [
        Times(n, 10 * n, 50 * n, 1e-3 * n, 5, 3e-3 * n, 5, 0.1, 1e-5 * n**2, (1.0, 1.0)) for n in (10, 20)
    ]
    draw_growth(tmp_path / "deep" / "growth.png", rows, rows)
    assert (tmp_path / "deep" / "growth.png").stat().st_size > 10_000
