"""The last step of the back end: IPOPT from where Gauss-Newton ends; the result says what each did."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import LinAlgError

from polhode.backend.solvers.casadi_nlp import OPTIMAL
from polhode.backend.solvers.gauss_newton import (
    ITERATION_LIMIT,
    TIME_LIMIT,
    Damping,
    GaussNewton,
    NormalEquations,
    Solution,
)
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import TIGHT_GAUGE, LinearizationPoint, MotionFit
from polhode.backend.solvers.solve import refine, solve
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.backend.motions import FAST, TUMBLE, cold_start, estimated

SCENE = replace(TUMBLE, frames=24, landmarks=200)


@pytest.fixture(scope="module")
def cold() -> MotionFit:
    """A problem and its cold start, from relative poses and with a sphere's inertia."""
    return cold_start(generate(SCENE, 3), Backend())


def test_ipopt_gives_the_answer_from_where_gauss_newton_ends(cold: MotionFit) -> None:
    newton, found = solve(cold, FAST), solve(cold, Backend())
    assert (newton.solver, found.solver) == ("gauss_newton", "ipopt")
    assert newton.solution.converged and found.solution.converged
    assert newton.solution.program is None and found.solution.program is not None
    program = found.solution.program
    assert 1 <= program.iterations <= 3 and found.iterations == newton.iterations + program.iterations
    assert program.status in OPTIMAL and program.constraint_violation == 0.0 and program.seconds > 0.0
    assert "gauss_newton" not in found.solution.message
    assert found.solution.cost == pytest.approx(newton.solution.cost, rel=1e-6)
    assert 0.0 <= program.optimality < 1e-3
    result = estimated(generate(SCENE, 3), Backend()).solver
    assert (result.name, result.converged) == ("ipopt", True)


def test_an_answer_that_ipopt_cannot_confirm_is_that_of_gauss_newton(
    cold: MotionFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = MotionProgram.solve

    def stops(*given: Any) -> Solution:
        found = ends(*given)
        return replace(found, x=given[2], cost=np.inf, converged=False, message="Restoration_Failed")

    monkeypatch.setattr(MotionProgram, "solve", stops)
    found = solve(cold, Backend())
    assert found.solver == "gauss_newton" and found.solution.converged
    assert found.solution.program is not None


def test_where_gauss_newton_does_not_converge_ipopt_goes_on_and_the_result_says_so(cold: MotionFit) -> None:
    best = solve(cold, FAST)
    found = solve(cold, Backend(solver="gauss_newton", max_iterations=12))
    assert best.iterations > 6
    assert found.solver == "ipopt" and found.solution.converged and found.iterations > 6
    assert found.solution.message == "converged, after 6 iterations of gauss_newton without convergence"
    assert found.solution.cost == pytest.approx(best.solution.cost, rel=1e-6)


def test_when_neither_converges_the_better_one_is_kept_and_the_limit_named(cold: MotionFit) -> None:
    found = solve(cold, Backend(max_iterations=2))
    assert not found.solution.converged and ITERATION_LIMIT in found.solution.message
    alone, _, _ = refine(GaussNewton(cold.data, line_search=True), cold.iterate, 1)
    fixed = MotionFit(cold.data, alone).linearized(TIGHT_GAUGE)
    assert found.solution.cost <= GaussNewton(cold.data).cost(fixed, alone.vector())
    found = solve(cold, Backend(max_seconds=1e-6))
    assert found.solver == "gauss_newton" and found.solution.message == TIME_LIMIT


def test_equations_without_a_solution_are_left_to_ipopt(
    cold: MotionFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*given: object) -> Solution:
        raise LinAlgError

    monkeypatch.setattr(GaussNewton, "solve", fails)
    found = solve(cold, Backend())
    assert found.solver == "ipopt" and found.solution.converged
    # where IPOPT fails too the caller learns of it
    monkeypatch.setattr(MotionProgram, "solve", fails)
    with pytest.raises(LinAlgError):
        solve(cold, Backend())


def test_a_line_search_ends_no_higher_in_fewer_iterations(cold: MotionFit) -> None:
    fixed, x = cold.linearized(), cold.iterate.vector()
    plain, found = (GaussNewton(cold.data, line_search=on).solve(fixed, x, 200) for on in (False, True))
    assert plain.converged and found.converged
    assert found.cost <= plain.cost * (1.0 + 1e-8)
    assert found.iterations < plain.iterations


class WithKernelCurvature(GaussNewton):
    """The curvature of the kernel makes an element of the diagonal negative, as far from a solution."""

    def normal_equations(
        self, fixed: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        system = super().normal_equations(fixed, x, weight, prior)
        if weight is None:
            system.H[0, 0] = -abs(system.H[0, 0])
        return system


def test_where_the_curvature_of_the_kernel_does_harm_the_solver_goes_on_without_it() -> None:
    scene = SyntheticScene(frames=16, landmarks=120, detection=0.5, w_G=(0.3, 0.5, 0.35))
    cold = cold_start(generate(scene, 3), Backend())
    fixed, x = cold.linearized(), cold.iterate.vector()
    usual, found = (solver(cold.data).solve(fixed, x, 20) for solver in (GaussNewton, WithKernelCurvature))
    assert found.cost == pytest.approx(usual.cost, rel=1e-6)
    solver = GaussNewton(cold.data)
    system = solver.normal_equations(fixed, x)
    system.H[0, 0] = -1.0
    # where no damping helps a step ends with an error
    with pytest.raises(LinAlgError):
        solver.step(system, Damping())
