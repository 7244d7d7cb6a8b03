"""From the same cold start the solvers end at the same cost; each keeps what it reached; formulations."""

from collections.abc import Callable
from contextlib import suppress
from time import process_time

import gtsam
import numpy as np
import pytest

from polhode.backend.problem.inertia import inertia_from_second_moments
from polhode.compare.problem.assessment import AGREED, assess, reference_covariance, sigmas
from polhode.compare.problem.blocks import Blocks
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.registry import ENTRIES, entries
from polhode.compare.solver import AdapterResult, OutOfTime, SolveMonitor
from polhode.compare.solvers.casadi_solvers import evaluation_s
from polhode.compare.solvers.condensed import ReducedCost
from polhode.compare.solvers.gtsam_solvers import Graph
from polhode.compare.solvers.thesis_methods import LogRatios, possible

AGREEING = (
    "gauss_newton", "gauss_newton_ratios", "ipopt", "ipopt_condensed", "sqp_osqp", "sqp_ipqp", "ceres",
    "gtsam_lm", "gtsam_isam2",
)  # fmt: skip
Solve = Callable[[str], tuple[AdapterResult, SolveMonitor]]


@pytest.fixture(scope="module")
def solve(small: MeasuredProblem) -> Solve:
    """Results from the cold start, each solver once."""
    known: dict[str, tuple[AdapterResult, SolveMonitor]] = {}

    def solve(name: str) -> tuple[AdapterResult, SolveMonitor]:
        if name not in known:
            monitor = SolveMonitor(120.0)
            known[name] = entries((name,))[0].load().solve(small, small.cold, monitor), monitor
        return known[name]

    return solve


@pytest.mark.parametrize("name", AGREEING)
def test_from_a_cold_start_they_agree(name: str, solve: Solve, small: MeasuredProblem) -> None:
    found, monitor = solve(name)
    least, verdict = assess(small, small.solution), assess(small, found.x)
    assert found.converged
    assert verdict.cost is not None and least.cost is not None
    assert abs(verdict.cost / least.cost - 1.0) < AGREED
    assert verdict.gain_left is not None and verdict.gain_left < AGREED
    if name in ("ceres", "gtsam_lm", "gtsam_isam2"):
        own = sigmas(small, found.x, found.cov_constants)
        reference = sigmas(small, small.solution, reference_covariance(small, small.solution))
        # they weigh the kernel's curvature in different ways
        assert np.allclose(np.array(own, float), np.array(reference, float), rtol=0.05)
    if name.startswith("gtsam"):
        # its C++ evaluates factors inside its own steps; the calls of Python are timed
        assert "C++" in monitor.not_separable and 0.0 < monitor.callback_s < monitor.elapsed()
    if name in ("ceres", "sqp_osqp", "ipopt_condensed"):
        assert_evaluation_is_part_of_the_time(monitor)


def assert_evaluation_is_part_of_the_time(monitor: SolveMonitor) -> None:
    spent = monitor.seconds["evaluation"]
    assert monitor.not_separable == ""
    assert 0.05 * monitor.elapsed() < spent < monitor.elapsed() - monitor.seconds["build"]


@pytest.mark.parametrize("name", ["odometry", "dynamic_isam"])
def test_baselines_answer_in_the_common_unknowns(name: str, solve: Solve, small: MeasuredProblem) -> None:
    found, monitor = solve(name)
    verdict = assess(small, found.x)
    assert found.converged
    assert verdict.cost is not None and verdict.errors is not None
    # another formulation is no better on the common cost
    assert verdict.cost > (assess(small, small.solution).cost or np.inf)
    assert_evaluation_is_part_of_the_time(monitor)


@pytest.mark.parametrize("name", [entry.name for entry in ENTRIES])
def test_each_keeps_a_whole_point_that_descends_or_says_how_far_it_was_and_leaves_its_start(
    name: str, small: MeasuredProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the processor's time: on a busy machine, too, it gets as far
    monkeypatch.setattr("polhode.compare.solver.perf_counter", process_time)
    monitor, start, ended = SolveMonitor(0.7, process_time()), small.cold.copy(), False
    with suppress(OutOfTime):
        entries((name,))[0].load().solve(small, start, monitor)
        # a fast machine may come to the end
        ended = True
    np.testing.assert_array_equal(start, small.cold)
    kept, x = monitor.kept()
    if name in ("dynamic_isam", "gtsam_isam2") and x is None:
        assert kept == "nothing" and (ended or monitor.status.endswith("of 20 frames were in"))
        return
    # without dynamics the cost on the way is not the common one
    assert kept == ("last" if name == "odometry" else "best")
    assert x is not None and x.shape == small.cold.shape
    reached, before = assess(small, x).cost, assess(small, small.cold).cost
    assert reached is not None and before is not None
    if monitor.best is not None:
        assert np.isclose(reached, monitor.best[0], rtol=1e-9) and reached <= before * (1.0 + 1e-12)


def test_the_parts_of_an_sqp_step_are_all_counted() -> None:
    """CasADi's SQP method calls joint functions, which have names of their own in its statistics."""
    stats = {"t_wall_nlp_hess_l": 1.0, "t_wall_nlp_jac_fg": 2.0, "t_wall_nlp_fg": 4.0, "t_wall_QP": 8.0}
    assert evaluation_s(stats) == 7.0
    monitor = SolveMonitor(120.0)
    with monitor.callback(None):
        pass
    assert monitor.seconds["evaluation"] == 0.0 and monitor.callback_s > 0.0


def test_the_graph_has_the_common_cost_and_its_gradient(small: MeasuredProblem) -> None:
    graph, x = Graph(small, SolveMonitor(60.0)), small.start("near", 2)
    factors, values = graph.all(x), graph.values(x)
    assert np.isclose(factors.error(values), Blocks(small.data, small.fixed).cost(x), rtol=1e-10)
    assert np.allclose(graph.vector(values), x, atol=1e-12)
    linear, rng = factors.linearize(values), np.random.default_rng(4)
    delta, opposite = gtsam.VectorValues(), gtsam.VectorValues()
    for key in values.keys():  # noqa: SIM118
        kind = chr(gtsam.Symbol(key).chr())
        size = {"x": 6, "l": 3}.get(kind) or len(np.atleast_1d(values.atVector(key)))
        delta.insert(key, 1e-6 * rng.normal(size=size))
        opposite.insert(key, -delta.at(key))
    costs = [factors.error(values.retract(each)) for each in (delta, opposite)]
    zero = gtsam.VectorValues.Zero(delta)
    # the linear graph's own error changes by the gradient, and by curvature that the difference cancels
    slopes = [linear.error(each) - linear.error(zero) for each in (delta, opposite)]
    assert np.isclose(costs[0] - costs[1], slopes[0] - slopes[1], rtol=1e-4)


def test_the_reduced_cost_is_the_least_over_the_landmarks(small: MeasuredProblem) -> None:
    reduced = ReducedCost(small, small.cold, SolveMonitor(60.0))
    y = small.start("near", 5)[: reduced.n]
    cost, blocks = reduced.cost(y), Blocks(small.data, small.fixed)
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
    second = form.second_moments(xi, np.eye(3))
    moments = np.sort(np.linalg.eigvalsh(inertia_from_second_moments(second)))[::-1]
    assert np.allclose(np.log(moments[:2] / moments[1:]), xi[:2])
    assert possible(xi) and not possible(np.array([1.5, 0.1]))
    slopes = form.derivative(xi, np.eye(3))
    for n, step in enumerate(1e-6 * np.eye(5)):
        difference = form.second_moments(xi + step, np.eye(3)) - form.second_moments(xi - step, np.eye(3))
        assert np.allclose(difference / 2e-6, slopes[n], atol=1e-8)
    again, R = form.coordinates(second)
    assert np.allclose(form.second_moments(again, R), second)
