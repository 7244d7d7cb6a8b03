"""The reference solver: exact derivatives, descent from far away, the same as IPOPT (test_ipopt)."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.window.newton import NewtonSolver
from polhode.backend.window.problem import WindowProblem
from polhode.lie import Array
from polhode.simulation.monte_carlo import SyntheticSequence
from tests.backend.window.conftest import Feed, problem_of


@pytest.fixture(scope="module")
def solved(tumble: SyntheticSequence, feed: Feed) -> tuple[WindowProblem, Array]:
    window, _ = feed(tumble, 14, frames=30)
    return problem_of(window)


def test_gradient_is_that_of_the_cost(solved: tuple[WindowProblem, Array]) -> None:
    problem, x = solved
    x = x + np.random.default_rng(0).normal(0.0, 1e-3, len(x))
    cost, _, g = problem.normal_equations(x)
    assert cost == pytest.approx(problem.cost(x), rel=1e-9)
    for at in (0, 3, 7, 10, 40, len(x) - 7, len(x) - 4, len(x) - 1):
        e = np.zeros_like(x)
        e[at] = 1e-6
        slope = (problem.cost(x + e) - problem.cost(x - e)) / 2e-6
        assert g[at] == pytest.approx(slope, rel=1e-4, abs=1e-6 * np.abs(g).max())


def test_the_window_rests_at_the_optimum(solved: tuple[WindowProblem, Array]) -> None:
    problem, x = solved
    solution = NewtonSolver().solve(problem, x, 20)
    assert solution.converged
    assert problem.cost(x) - solution.cost < 0.02


def test_a_wrong_inertia_is_corrected(solved: tuple[WindowProblem, Array]) -> None:
    problem, x = solved
    wrong = x.copy()
    wrong[-5:] += [0.3, -0.2, 0.1, 0.2, -0.1]
    wrong[-8:-5] += 0.02
    solution = NewtonSolver().solve(problem, wrong, 40)
    assert solution.converged
    best = NewtonSolver().solve(problem, x, 40)
    assert solution.cost == pytest.approx(best.cost, abs=0.01)


def test_rates_far_off_do_not_stop_it_where_frames_follow_fast(solved: tuple[WindowProblem, Array]) -> None:
    problem, x = solved
    # as after 10 ms: steps so stiff that only the states may follow
    as_it_is = problem.factors.steps
    steps = replace(as_it_is, W_t=30.0 * as_it_is.W_t, W_r=30.0 * as_it_is.W_r)
    stiff = replace(problem, factors=replace(problem.factors, steps=steps))
    wrong = x.copy()
    wrong[:-8].reshape(-1, 12)[:, 9:] += np.random.default_rng(1).normal(0.0, 0.05, (14, 3))
    best = NewtonSolver().solve(stiff, x, 40)
    assert NewtonSolver().solve(stiff, wrong, 60).cost == pytest.approx(best.cost, abs=0.05)
