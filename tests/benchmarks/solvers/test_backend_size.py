"""The parts of a run are distinguished by the calls of its progress."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.solvers.backend_size import PARTS, Clock, PhaseTimes, draw_growth, exponent, measure, warm
from polhode.compare.problem.sources import THESIS

SMALL = replace(THESIS, frames=10, landmarks=150)


def test_the_exponent_of_a_power_is_the_power() -> None:
    sizes = np.array([10.0, 30.0, 100.0])
    assert exponent(sizes, 3e-3 * sizes**2.5) == pytest.approx(2.5)


def test_both_solvers_are_timed_on_the_way_to_the_same_cost() -> None:
    times = measure(SMALL)
    assert times.frames == 10 and times.landmarks <= 150
    assert times.costs[0] == pytest.approx(times.costs[1], rel=1e-7)
    assert min(times.gauss_newton_s, times.ipopt_s, times.build_s, times.answer_s, times.covariance_s) > 0.0
    assert 1 < times.gauss_newton_iterations < 60 and 1 < times.ipopt_iterations < 60
    assert 1 <= times.answer_iterations <= 6


def test_the_growth_is_drawn(tmp_path: Path) -> None:
    rows = [
        PhaseTimes(n, 10 * n, 50 * n, 1e-3 * n, 5, 3e-3 * n, 5, 0.1, 0.2, 2, 1e-5 * n**2, (1.0, 1.0))
        for n in (10, 20)
    ]
    draw_growth(tmp_path / "deep" / "growth.png", rows, rows)
    assert (tmp_path / "deep" / "growth.png").stat().st_size > 10_000


def test_the_clock_joins_the_hypotheses_and_tells_the_other_parts_apart() -> None:
    clock = Clock()
    with clock.stage("motion and inertia", 7) as advance:
        for work_s in (0.01, 0.02, 0.01, 0.03, 0.0, 0.05, 0.0):
            end = time.process_time() + work_s
            while time.process_time() < end:
                pass
            advance()
    parts_s = clock.parts_s()
    assert len(parts_s) == len(PARTS)
    np.testing.assert_array_less(np.array([0.04, 0.03, 0.0, 0.05, 0.0]) - 1e-3, parts_s)
    assert parts_s.sum() == pytest.approx(clock.at[-1] - clock.at[0])


def test_the_loops_are_warmed_by_a_motion_that_either_solver_finds() -> None:
    names = [estimate.solver.name for estimate in warm() if estimate.solver.converged]
    assert names == ["ipopt", "gauss_newton"]
