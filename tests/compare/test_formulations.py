"""Every formulation is the common cost: CasADi programs, GTSAM graphs, the reduced cost, other inertias."""

from pathlib import Path

import gtsam
import numpy as np
import pytest

from polhode.backend.problem.inertia import inertia_from_second_moments
from polhode.compare.problem.blocks import Blocks
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import SolveMonitor
from polhode.compare.solvers.casadi_program import Formulation, VariantProgram
from polhode.compare.solvers.condensed import ReducedCost
from polhode.compare.solvers.gtsam_solvers import Graph
from polhode.compare.solvers.thesis_methods import LogRatios, possible

FORMULATIONS = [
    Formulation("gauss_newton", "weighted", "vm"),
    Formulation("exact", "weighted", "vm"),
    Formulation("exact", "slack", "vm"),
    Formulation("exact", "weighted", "c"),
]


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=lambda f: f"{f.hessian}-{f.dynamics}-{f.code}")
def test_a_program_has_the_common_cost_and_its_derivatives(
    small: MeasuredProblem, formulation: Formulation, tmp_path: Path
) -> None:
    program = VariantProgram(small, formulation, tmp_path)
    _, given = program.functions()
    rng, x = np.random.default_rng(1), small.start("near", 0)
    slack = Blocks(small.data, small.fixed).dynamics(x).residual.ravel() if program.n_slack else np.zeros(0)
    z = np.concatenate([x, slack])
    multiplier = rng.normal(size=program.n_slack)

    def slope(z: np.ndarray) -> np.ndarray:
        gradient = np.asarray(given["grad_f"](z, program.p)[1]).ravel()
        if program.n_slack:
            gradient = gradient + np.asarray(given["jac_g"](z, program.p)[1]).T @ multiplier
        return gradient

    cost = float(given["grad_f"](z, program.p)[0])
    assert np.isclose(cost, Blocks(small.data, small.fixed).cost(x), rtol=1e-10)
    if program.n_slack:
        violation = np.asarray(given["jac_g"](z, program.p)[0]).ravel()
        assert np.abs(violation).max() < 1e-6
    along, step = rng.normal(size=len(z)), 1e-6
    costs = [float(given["grad_f"](z + s * step * along, program.p)[0]) for s in (1.0, -1.0)]
    gradient = np.asarray(given["grad_f"](z, program.p)[1]).ravel()
    assert np.isclose((costs[0] - costs[1]) / (2.0 * step), gradient @ along, rtol=1e-4)
    upper = np.asarray(given["hess_lag"](z, program.p, 1.0, multiplier))
    bend = upper @ along + np.triu(upper, 1).T @ along
    difference = (slope(z + step * along) - slope(z - step * along)) / (2.0 * step)
    # the Gauss-Newton Hessian leaves out what small residuals bend
    wanted = 1e-4 if formulation.hessian == "exact" else 0.1
    assert np.abs(difference - bend).max() < wanted * np.abs(bend).max()


def test_the_graph_has_the_common_cost_and_its_gradient(small: MeasuredProblem) -> None:
    graph = Graph(small, SolveMonitor(60.0))
    x = small.start("near", 2)
    factors, values = graph.all(x), graph.values(x)
    blocks = Blocks(small.data, small.fixed)
    assert np.isclose(factors.error(values), blocks.cost(x), rtol=1e-10)
    assert np.allclose(graph.vector(values), x, atol=1e-12)
    linear = factors.linearize(values)
    rng, step = np.random.default_rng(4), 1e-6
    delta = gtsam.VectorValues()
    for key in values.keys():  # noqa: SIM118
        size = 6 if chr(gtsam.Symbol(key).chr()) == "x" else len(np.atleast_1d(_vector(values, key)))
        delta.insert(key, step * rng.normal(size=size))
    opposite = gtsam.VectorValues()
    for key in values.keys():  # noqa: SIM118
        opposite.insert(key, -delta.at(key))
    costs = [factors.error(values.retract(each)) for each in (delta, opposite)]
    zero = gtsam.VectorValues.Zero(delta)
    # the linear graph's own error changes by the gradient, and by curvature that the difference cancels
    slopes = [linear.error(each) - linear.error(zero) for each in (delta, opposite)]
    assert np.isclose(costs[0] - costs[1], slopes[0] - slopes[1], rtol=1e-4)


def _vector(values: gtsam.Values, key: int) -> np.ndarray:
    kind = chr(gtsam.Symbol(key).chr())
    return np.asarray(values.atPoint3(key) if kind == "l" else values.atVector(key))


def test_the_reduced_cost_is_the_least_over_the_landmarks(small: MeasuredProblem) -> None:
    reduced = ReducedCost(small, small.cold, SolveMonitor(60.0))
    y = small.start("near", 5)[: reduced.n]
    cost = reduced.cost(y)
    blocks = Blocks(small.data, small.fixed)
    assert np.isclose(blocks.cost(np.concatenate([y, reduced.landmarks])), cost, rtol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(3):
        moved = reduced.landmarks + 1e-4 * rng.normal(size=len(reduced.landmarks))
        assert blocks.cost(np.concatenate([y, moved])) > cost
    along, step = rng.normal(size=reduced.n), 1e-6
    gradient = reduced.gradient(y)
    costs = [reduced.cost(y + s * step * along) for s in (1.0, -1.0)]
    assert np.isclose((costs[0] - costs[1]) / (2.0 * step), gradient @ along, rtol=1e-4)


def test_the_thesis_inertia_has_its_ratios_and_derivatives() -> None:
    form, xi = LogRatios(), np.array([0.2, 0.1, 0.3, -0.2, 0.4])
    J = inertia_from_second_moments(form.second_moments(xi, np.eye(3)))
    moments = np.sort(np.linalg.eigvalsh(J))[::-1]
    assert np.allclose(np.log(moments[:2] / moments[1:]), xi[:2])
    assert possible(xi) and not possible(np.array([1.5, 0.1]))
    slopes = form.derivative(xi, np.eye(3))
    for n in range(5):
        step = np.zeros(5)
        step[n] = 1e-6
        difference = form.second_moments(xi + step, np.eye(3)) - form.second_moments(xi - step, np.eye(3))
        assert np.allclose(difference / 2e-6, slopes[n], atol=1e-8)
    again, R = form.coordinates(form.second_moments(xi, np.eye(3)))
    assert np.allclose(form.second_moments(again, R), form.second_moments(xi, np.eye(3)))
