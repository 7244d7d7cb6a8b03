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
from polhode.compare.solver import Outcome, OutOfTime, SolveMonitor
from polhode.lie import Array

MAX_ITERATIONS, PASS = 500, 12


def _same(x: Array) -> Array:
    return x


class TimedGaussNewton(GaussNewton):
    """The same solver; its clock is read at each linearisation."""

    def __init__(
        self, data: MotionData, monitor: SolveMonitor, with_dynamics: bool = True, line_search: bool = False
    ) -> None:
        super().__init__(data, with_dynamics, line_search)
        self.monitor = monitor

    def normal_equations(
        self, held: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        """TimedGaussNewton; ends the solution at its limit."""
        with self.monitor.part("evaluation"):
            system = super().normal_equations(held, x, weight, prior)
        self.note(system.cost, x)
        self.monitor.check()
        return system

    def note(self, cost: float, x: Array) -> None:
        """Nothing is noted."""

    def cost(self, held: LinearizationPoint, x: Array) -> float:
        """TimedGaussNewton."""
        with self.monitor.part("evaluation"):
            return super().cost(held, x)


class MonitoredGaussNewton(TimedGaussNewton):
    """As the last step of the back end has it; what was reached is noted at each linearisation.

    ``common`` takes its unknowns to the common ones. Without dynamics its cost is not the common one.
    """

    def __init__(
        self,
        data: MotionData,
        monitor: SolveMonitor,
        common: Callable[[Array], Array] = _same,
        with_dynamics: bool = True,
    ) -> None:
        super().__init__(data, monitor, with_dynamics, line_search=with_dynamics)
        self.common = common

    def note(self, cost: float, x: Array) -> None:
        """What was reached, in the common unknowns."""
        self.monitor.note(cost, self.common(x), common=self.with_dynamics)


@dataclass
class Ours:
    """Gauss-Newton in one form of the inertia."""

    form: str = "second_moments"

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """Solve in the form's own coordinates, again until the cost rests (``backend.solvers.solve.refine``).

        A form with a reference rotation has it renewed every few iterations, the common form has
        none.
        """
        own, common = problem, self.form == problem.data.form.name
        before, total, iterations = np.inf, 0, MAX_ITERATIONS if common else PASS
        while True:
            with monitor.part("build"):
                if not common:
                    own = with_form(problem, self.form, problem.iterate(x))
                to_common = _same if common else partial(in_form, own, problem)
                solver = MonitoredGaussNewton(own.data, monitor, to_common)
            start = x if common else in_form(problem, own, x)
            found = _solved(solver, own.held, start, iterations)
            x, total = found.x if common else in_form(own, problem, found.x), total + found.iterations
            resting = before - found.cost <= PASS_TOLERANCE * found.cost
            if (found.converged and resting) or total >= MAX_ITERATIONS:
                break
            before = found.cost
        monitor.stop()
        cov = reference_covariance(problem, x) if common else None
        return Outcome(x, found.converged, total, found.message, cov)


def _solved(solver: MonitoredGaussNewton, held: LinearizationPoint, x: Array, iterations: int) -> Solution:
    found = solver.solve(held, x, iterations, max(solver.monitor.left(), 0.0))
    solver.note(found.cost, found.x)
    if found.message == TIME_LIMIT:
        raise OutOfTime
    return found


def in_form(before: MeasuredProblem, after: MeasuredProblem, x: Array) -> Array:
    """The same unknowns with the inertia in the other problem's coordinates."""
    out, at = x.copy(), before.iterate(x)
    second = at.second_moments(before.data.form)
    out[at.n_states + 3 : at.n_states + 8] = inertia_around(second, after.data, after.held.reference)
    return out
