"""From the same cold start the solvers end at the same cost; the baselines answer."""

from contextlib import suppress
from time import process_time

import numpy as np
import pytest

from polhode.compare.problem.assessment import AGREED, assess, reference_covariance, sigmas
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.registry import ENTRIES, entries
from polhode.compare.solver import AdapterResult, OutOfTime, SolveMonitor
from polhode.compare.solvers.casadi_solvers import evaluation_s

AGREEING = (
    "gauss_newton", "gauss_newton_ratios", "ipopt", "ipopt_condensed", "ipopt_vm", "ipopt_c",
    "ipopt_exact_vm",
    "sqp_osqp", "sqp_ipqp", "ceres", "gtsam_lm", "gtsam_isam2",
)  # fmt: skip
BASELINES = ("odometry", "dynamic_isam")


def solve(
    name: str, problem: MeasuredProblem, start: str = "cold", monitor: SolveMonitor | None = None
) -> AdapterResult:
    x = problem.start(start, 0)
    return entries((name,))[0].load().solve(problem, x, monitor or SolveMonitor(120.0))


class EnoughMonitor(SolveMonitor):
    """Ends a solve at its limit, or as soon as its cost is this low."""

    def __init__(self, limit_s: float, cost: float) -> None:
        super().__init__(limit_s)
        self.enough = cost

    def check(self) -> None:
        super().check()
        if self.best is not None and self.best[0] < self.enough:
            raise OutOfTime


@pytest.mark.parametrize("name", AGREEING)
def test_from_a_cold_start_they_agree(name: str, small: MeasuredProblem) -> None:
    found = solve(name, small)
    least = assess(small, small.solution)
    verdict = assess(small, found.x)
    assert found.converged
    assert verdict.cost is not None and least.cost is not None
    assert abs(verdict.cost / least.cost - 1.0) < AGREED
    assert verdict.gain_left is not None and verdict.gain_left < AGREED


@pytest.mark.parametrize("name", ["ceres", "gtsam_lm", "gtsam_isam2"])
def test_their_covariances_agree_with_the_reference(name: str, small: MeasuredProblem) -> None:
    found = solve(name, small, start="near")
    own = sigmas(small, found.x, found.cov_constants)
    reference = sigmas(small, small.solution, reference_covariance(small, small.solution))
    # they weigh the kernel's curvature in different ways
    assert np.allclose(np.array(own, float), np.array(reference, float), rtol=0.05)


@pytest.mark.parametrize("name", ["ipopt_slack", "ipopt_slack_exact"])
def test_with_slack_they_come_in_from_very_near(name: str, small: MeasuredProblem) -> None:
    x = small.perturbed(small.solution, 0, size=0.001)
    found = entries((name,))[0].load().solve(small, x, SolveMonitor(120.0))
    verdict, least = assess(small, found.x), assess(small, small.solution).cost
    assert verdict.cost is not None and least is not None
    assert abs(verdict.cost / least - 1.0) < AGREED


@pytest.mark.parametrize("name", BASELINES)
def test_baselines_answer_in_the_common_unknowns(name: str, small: MeasuredProblem) -> None:
    found = solve(name, small)
    verdict = assess(small, found.x)
    assert found.converged
    assert verdict.cost is not None and verdict.errors is not None
    # another formulation is no better on the common cost
    assert verdict.cost > (assess(small, small.solution).cost or np.inf)


@pytest.mark.parametrize(
    "name",
    ["gauss_newton", "gauss_newton_ratios", "ipopt", "scipy_trf", "belief_propagation", "sqp_qrqp", "ceres"],
)
def test_they_descend_and_stop_at_the_limit(name: str, small: MeasuredProblem) -> None:
    monitor, before = SolveMonitor(0.25), assess(small, small.cold).cost
    # a fast machine may come to the end
    with suppress(OutOfTime):
        solve(name, small, monitor=monitor)
    assert monitor.best is not None and before is not None
    reached = assess(small, monitor.best[1]).cost
    assert reached is not None and np.isclose(reached, monitor.best[0], rtol=1e-9)
    assert reached <= before * (1.0 + 1e-12)


KEEP_THE_LAST = ("odometry", "ipopt_slack", "ipopt_slack_exact")
"""Their own cost on the way is not the common one."""


@pytest.mark.parametrize("name", [entry.name for entry in ENTRIES])
def test_each_keeps_a_whole_point_on_its_way_or_tells_how_far_it_was_and_leaves_its_start(
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
    assert kept == ("last" if name in KEEP_THE_LAST else "best")
    assert x is not None and x.shape == small.cold.shape
    assert assess(small, x).cost is not None


@pytest.mark.parametrize("name", ["odometry", "dynamic_isam", "ceres", "sqp_osqp", "ipopt_condensed"])
def test_evaluation_is_part_of_the_time(name: str, small: MeasuredProblem) -> None:
    monitor = SolveMonitor(120.0)
    solve(name, small, monitor=monitor)
    assert monitor.not_separable == ""
    spent = monitor.seconds["evaluation"]
    assert 0.05 * monitor.elapsed() < spent < monitor.elapsed() - monitor.seconds["build"]


@pytest.mark.parametrize("name", ["gtsam_lm", "gtsam_isam2"])
def test_what_a_foreign_library_evaluates_inside_is_not_told_apart(name: str, small: MeasuredProblem) -> None:
    monitor = SolveMonitor(120.0)
    solve(name, small, "near", monitor)
    assert "C++" in monitor.not_separable
    # the calls of Python are
    assert 0.0 < monitor.callback_s < monitor.elapsed()


def test_the_parts_of_an_sqp_step_are_all_counted(small: MeasuredProblem) -> None:
    """CasADi's SQP method calls joint functions, which have names of their own in its statistics."""
    stats = {"t_wall_nlp_hess_l": 1.0, "t_wall_nlp_jac_fg": 2.0, "t_wall_nlp_fg": 4.0, "t_wall_QP": 8.0}
    assert evaluation_s(stats) == 7.0
    monitor = SolveMonitor(120.0)
    with monitor.callback(None):
        pass
    assert monitor.seconds["evaluation"] == 0.0 and monitor.callback_s > 0.0


def test_belief_propagation_comes_close(small: MeasuredProblem) -> None:
    least = assess(small, small.solution).cost
    assert least is not None
    monitor = EnoughMonitor(20.0, 1.1 * least)
    with suppress(OutOfTime):
        solve("belief_propagation", small, monitor=monitor)
    assert monitor.best is not None
    assert monitor.best[0] < 1.1 * least
