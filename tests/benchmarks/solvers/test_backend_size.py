"""The parts of a run are told apart by the calls of its progress."""

import time

import numpy as np
import pytest

from benchmarks.solvers.backend_size import PARTS, Clock, warm


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
