"""The reference solver: exact derivatives, descent from far away, the same as IPOPT (test_ipopt)."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.dynamics.residuals import add_steps, dynamics_residuals
from polhode.backend.problem.inertia import FORMS, inertia_from_second_moments
from polhode.backend.problem.iterate import N_STATE
from polhode.backend.window.problem import (
    MOST_SERIES,
    DisturbanceLevels,
    IpoptSolver,
    Quadratic,
    WindowProblem,
    eliminate,
    solve_newton,
    states_of_vector,
    step_jacobians,
    whitened_steps,
)
from polhode.backend.window.solve import confirmed
from polhode.geometry.lie import Array, exp_so3
from polhode.simulation.monte_carlo import SyntheticSequence
from tests.backend.window.conftest import Feed, problem_of

RNG = np.random.default_rng(1)
DT_S = np.array([0.5, 0.3, 0.7])
LEVELS = DisturbanceLevels(1e-6, 1e-6)


def information(n: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n), rng.normal(size=n)


def test_what_is_left_is_the_marginal_and_the_eliminated_entries_follow_to_the_joint_optimum() -> None:
    H, g = information(9, 0)
    gone, kept = np.array([1, 4, 5]), np.array([0, 2, 3, 6, 7, 8])
    left, best = eliminate(H, g, gone, kept), np.asarray(np.linalg.solve(H, -g), dtype=np.float64)
    np.testing.assert_allclose(np.linalg.inv(left.H), np.linalg.inv(H)[np.ix_(kept, kept)], rtol=1e-9)
    np.testing.assert_allclose(np.linalg.solve(left.H, -left.g), best[kept], rtol=1e-9)
    np.testing.assert_allclose(left.follow(best[kept]), best[gone], rtol=1e-9)
    whole = eliminate(H, g, np.zeros(0, np.int64), np.arange(9))
    np.testing.assert_array_equal(whole.H, H)
    assert whole.follow(np.ones(9)).shape == (0,)
    rng = np.random.default_rng(4)
    quadratic, x, d = Quadratic(H, g, rng.normal(size=9)), rng.normal(size=9), rng.normal(size=9)
    slope = (quadratic.value(x + 1e-5 * d) - quadratic.value(x - 1e-5 * d)) / 2e-5
    np.testing.assert_allclose(quadratic.gradient(x) @ d, slope, rtol=1e-7)


def unknowns() -> tuple[Array, Array]:
    """States of four frames that follow each other roughly, and the constants."""
    states = np.zeros((4, 12))
    w_G = np.array([0.3, 0.5, -0.2])
    R_ref = exp_so3(np.outer(np.concatenate([[0.0], np.cumsum(DT_S)]), w_G))
    states[:, :9], states[:, 9:] = RNG.normal(0.0, 0.02, (4, 9)), w_G + RNG.normal(0.0, 0.02, (4, 3))
    return np.concatenate([states.ravel(), [4e-3, -1e-3, 2e-3], RNG.normal(0.0, 0.1, 5)]), R_ref


@pytest.mark.parametrize("name", ["second_moments", "ratios_axes"])
def test_gradient_of_the_steps_cost(name: str) -> None:
    form = FORMS[name]
    x, R_ref = unknowns()
    xi, R_inertia = form.coordinates(np.diag([1.0, 1.4, 2.0]))
    x[-5:] += xi
    steps = whitened_steps(x[:-8].reshape(-1, 12)[:-1, 9:], np.eye(3), np.eye(3), DT_S, LEVELS)

    def residuals(x: Array) -> Array:
        J_G = inertia_from_second_moments(form.second_moments(x[-5:], R_inertia))
        return dynamics_residuals(states_of_vector(x, R_ref), steps, J_G)

    def cost(x: Array) -> float:
        return 0.5 * float(np.sum(residuals(x) ** 2))

    r, D = step_jacobians(x, R_ref, steps, form, R_inertia)
    np.testing.assert_allclose(residuals(x), r)
    H, g, step = np.zeros((56, 56)), np.zeros(56), 1e-6
    add_steps(H, g, r, D, N_STATE)

    slope = [(cost(x + step * e) - cost(x - step * e)) / (2 * step) for e in np.eye(56)]
    np.testing.assert_allclose(g, slope, rtol=1e-5, atol=1e-5 * np.abs(g).max())
    assert np.linalg.eigvalsh(H)[0] > -1e-9 * H.max()


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


def test_rates_far_off_do_not_stop_it_where_frames_follow_fast(solved: tuple[WindowProblem, Array]) -> None:
    problem, x = solved
    # as after 10 ms: steps so stiff that only the states may follow
    soft = problem.steps
    stiff = replace(problem, steps=replace(soft, W_t=30.0 * soft.W_t, W_r=30.0 * soft.W_r))
    wrong = x.copy()
    wrong[:-8].reshape(-1, 12)[:, 9:] += np.random.default_rng(1).normal(0.0, 0.05, (14, 3))
    best = solve_newton(stiff, x, 40)
    assert solve_newton(stiff, wrong, 60).cost == pytest.approx(best.cost, abs=0.05)


@pytest.mark.parametrize("places", [14, 17])
def test_same_optimum_as_gauss_newton(tumble: SyntheticSequence, feed: Feed, places: int) -> None:
    window, _ = feed(tumble, 14, frames=30)
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


def test_steps_of_too_many_series_are_left_to_gauss_newton(solved: tuple[WindowProblem, Array]) -> None:
    problem, x = solved
    series = np.full_like(problem.steps.series, MOST_SERIES + 1)
    many = replace(problem, steps=replace(problem.steps, series=series))
    found = IpoptSolver(14).solve(many, x)
    assert not found.converged and found.iterations == 0 and "9 series" in found.message
    np.testing.assert_array_equal(found.x, x)


def test_an_optimum_far_from_gauss_newtons_is_not_the_windows(tumble: SyntheticSequence, feed: Feed) -> None:
    window, _ = feed(tumble, 14, frames=30)
    problem, x = problem_of(window)
    best = solve_newton(problem, x, 50)
    _, H, _ = problem.normal_equations(best.x)
    along = np.eye(len(x))[0] / np.sqrt(H[0, 0])
    near, far = replace(best, x=best.x + 0.9 * along), replace(best, x=best.x + 1.1 * along)
    assert confirmed(problem, best, near) is near
    assert confirmed(problem, best, far) is best
