"""IPOPT on the window's program reaches the optimum of the reference solver, in both forms of the inertia."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.window.problem import IpoptSolver, solve_newton
from polhode.backend.window.solve import confirmed
from polhode.simulation.monte_carlo import SyntheticSequence
from tests.backend.window.conftest import Feed, problem_of


@pytest.mark.parametrize("inertia", ["second_moments", "ratios_axes"])
@pytest.mark.parametrize("places", [14, 17])
def test_same_optimum_as_gauss_newton(
    tumble: SyntheticSequence, feed: Feed, inertia: str, places: int
) -> None:
    window, _ = feed(tumble, 14, inertia=inertia, frames=30)
    problem, x = problem_of(window)
    away = x + 0.3 * np.random.default_rng(2).normal(0.0, [*[1e-3] * (len(x) - 8), *[2e-3] * 3, *[0.02] * 5])
    # fewer states than places: the others are masked
    found = IpoptSolver(places).solve(problem, away)
    best = solve_newton(problem, away, 50)
    _, H, _ = problem.normal_equations(best.x)
    apart = found.x - best.x
    assert found.converged
    assert found.cost == pytest.approx(best.cost, abs=1e-3)
    assert np.sqrt(apart @ H @ apart) < 0.05  # standard deviations


def test_a_second_problem_needs_no_new_program(tumble: SyntheticSequence, feed: Feed) -> None:
    window, _ = feed(tumble, 10, frames=30)
    problem, x = problem_of(window)
    solver = IpoptSolver(12)
    solver.solve(problem, x)
    program = solver._program
    assert solver.solve(problem, x + 1e-4).converged
    assert solver._program is program


def test_an_optimum_far_from_gauss_newtons_is_not_the_windows(tumble: SyntheticSequence, feed: Feed) -> None:
    window, _ = feed(tumble, 14, frames=30)
    problem, x = problem_of(window)
    best = solve_newton(problem, x, 50)
    _, H, _ = problem.normal_equations(best.x)
    along = np.eye(len(x))[0] / np.sqrt(H[0, 0])
    near, far = replace(best, x=best.x + 0.9 * along), replace(best, x=best.x + 1.1 * along)
    assert confirmed(problem, best, near) is near
    assert confirmed(problem, best, far) is best
