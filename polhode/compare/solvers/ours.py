"""polhode's own Gauss-Newton (``backend.solvers.gauss_newton``) in either form of the inertia."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import TIME_LIMIT, GaussNewton, NormalEquations, Solution
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.backend.solvers.solve import PASS_TOLERANCE
from polhode.compare.problem.assessment import reference_covariance
from polhode.compare.problem.measured_problem import MeasuredProblem, inertia_around, with_form
from polhode.compare.solver import AdapterResult, OutOfTime, SolveMonitor
from polhode.geometry.lie import Array

MAX_ITERATIONS, PASS = 500, 12


class TimedGaussNewton(GaussNewton):
    """The same solver, with its times measured and its limit checked at each linearization."""

    def __init__(
        self, data: MotionData, monitor: SolveMonitor, with_dynamics: bool = True, line_search: bool = False
    ) -> None:
        super().__init__(data, with_dynamics, line_search)
        self.monitor = monitor

    def solve_in_time(self, fixed: LinearizationPoint, x: Array, max_iterations: int) -> Solution:
        """``solve`` in the time that is left. Raises OutOfTime at the limit."""
        found = self.solve(fixed, x, max_iterations, max(self.monitor.left(), 0.0))
        self.monitor.check()
        return found

    def normal_equations(
        self, fixed: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        """Raises OutOfTime at the limit."""
        with self.monitor.part("evaluation"):
            system = super().normal_equations(fixed, x, weight, prior)
        self.record(system.cost, x)
        self.monitor.check()
        return system

    def record(self, cost: float, x: Array) -> None:
        """Do not record the iterate: its cost or unknowns are not the common ones."""

    def cost(self, fixed: LinearizationPoint, x: Array) -> float:
        """With its time measured."""
        with self.monitor.part("evaluation"):
            return super().cost(fixed, x)


class MonitoredGaussNewton(TimedGaussNewton):
    """As in the last step of the back end, with each iterate recorded.

    ``common`` takes its unknowns to the common ones. Without dynamics its cost is not the common one.
    """

    def __init__(
        self,
        data: MotionData,
        monitor: SolveMonitor,
        common: Callable[[Array], Array] = lambda x: x,
        with_dynamics: bool = True,
    ) -> None:
        super().__init__(data, monitor, with_dynamics, line_search=with_dynamics)
        self.common = common

    def record(self, cost: float, x: Array) -> None:
        """Record the iterate in the common unknowns."""
        self.monitor.record(cost, self.common(x), common=self.with_dynamics)


@dataclass
class Ours:
    """Gauss-Newton in one form of the inertia."""

    form: str = "second_moments"

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Solve in the form's own coordinates, repeatedly until the cost is stationary (as
        ``backend.solvers.solve.refine``). The reference rotation of a form is renewed every few iterations.
        """
        own, common = problem, self.form == problem.data.form.name
        before, total, iterations = np.inf, 0, MAX_ITERATIONS if common else PASS
        while True:
            with monitor.part("build"):
                if not common:
                    own = with_form(problem, self.form, problem.iterate(x))
                solver = MonitoredGaussNewton(own.data, monitor, partial(in_form, own, problem))
            found = solver.solve(own.fixed, in_form(problem, own, x), iterations, max(monitor.left(), 0.0))
            solver.record(found.cost, found.x)
            if found.message == TIME_LIMIT:
                raise OutOfTime
            x, total = in_form(own, problem, found.x), total + found.iterations
            stationary = before - found.cost <= PASS_TOLERANCE * found.cost
            if (found.converged and stationary) or total >= MAX_ITERATIONS:
                break
            before = found.cost
        monitor.stop()
        cov = reference_covariance(problem, x) if common else None
        return AdapterResult(x, found.converged, total, found.message, cov)


def in_form(before: MeasuredProblem, after: MeasuredProblem, x: Array) -> Array:
    """The same unknowns with the inertia in the other problem's coordinates."""
    if before is after:
        return x
    out, at = x.copy(), before.iterate(x)
    second = at.second_moments(before.data.form)
    out[at.n_states + 3 : at.n_states + 8] = inertia_around(second, after.data, after.fixed.reference)
    return out
