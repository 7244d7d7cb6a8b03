"""From the same cold start the solvers end at the same cost; each keeps what it reached."""

from contextlib import suppress
from time import process_time

import gtsam
import numpy as np
import pytest

from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.compare.problem.assessment import AGREED, assess, reference_covariance, sigmas
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import ENTRIES, OutOfTime, SolveMonitor, entries
from polhode.compare.solvers.gtsam_lm import Graph

NAMES = [entry.name for entry in ENTRIES]


@pytest.mark.parametrize("name", NAMES)
def test_from_a_cold_start_they_agree(name: str, small: MeasuredProblem) -> None:
    least = assess(small, small.solution)
    found = entries((name,))[0].load().solve(small, small.cold, SolveMonitor(120.0))
    verdict = assess(small, found.x)
    assert found.converged
    assert verdict.cost is not None and least.cost is not None and verdict.gain_left is not None
    if name == "odometry":
        # another formulation is no better on the common cost
        assert verdict.cost > least.cost and verdict.errors is not None
    else:
        assert abs(verdict.cost / least.cost - 1.0) < AGREED and verdict.gain_left < AGREED
    if name in ("ceres", "gtsam_lm"):
        own = sigmas(small, found.x, found.cov_constants)
        reference = sigmas(small, small.solution, reference_covariance(small, small.solution))
        # they weigh the kernel's curvature in different ways
        assert np.allclose(np.array(own, float), np.array(reference, float), rtol=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_each_keeps_a_whole_point_that_descends_and_leaves_its_start(
    name: str, small: MeasuredProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the processor's time: on a busy machine, too, it gets as far
    monkeypatch.setattr("polhode.compare.solver.perf_counter", process_time)
    monitor, start = SolveMonitor(0.7, process_time()), small.cold.copy()
    with suppress(OutOfTime):
        entries((name,))[0].load().solve(small, start, monitor)
    np.testing.assert_array_equal(start, small.cold)
    kept, x = monitor.kept()
    # without dynamics the cost on the way is not the common one
    assert kept == ("last" if name == "odometry" else "best")
    assert x is not None and x.shape == small.cold.shape
    reached, before = assess(small, x).cost, assess(small, small.cold).cost
    assert reached is not None and before is not None
    if monitor.best is not None:
        assert np.isclose(reached, monitor.best[0], rtol=1e-9) and reached <= before * (1.0 + 1e-12)


def test_the_graph_has_the_common_cost_and_its_gradient(small: MeasuredProblem) -> None:
    graph, x = Graph(small), small.start("near", 2)
    factors, values = graph.factors(x), graph.values(x)
    assert np.isclose(factors.error(values), GaussNewton(small.data).cost(small.fixed, x), rtol=1e-10)
    assert np.allclose(graph.vector(values), x, atol=1e-12)
    linear, rng = factors.linearize(values), np.random.default_rng(4)
    delta, opposite = gtsam.VectorValues(), gtsam.VectorValues()
    for key in values.keys():  # noqa: SIM118
        kind = chr(gtsam.Symbol(key).chr())
        size = {"x": 6, "l": 3}.get(kind) or len(np.atleast_1d(values.atVector(key)))
        delta.insert(key, 1e-6 * rng.normal(size=size))
        opposite.insert(key, -delta.at(key))
    costs = [factors.error(values.retract(each)) for each in (delta, opposite)]
    # the linear graph's own error changes by the gradient, and by curvature that the difference cancels
    slopes = [linear.error(each) for each in (delta, opposite)]
    assert np.isclose(costs[0] - costs[1], slopes[0] - slopes[1], rtol=1e-4)
