"""polhode's own Gauss-Newton in either form of the inertia; as a baseline the odometry of the thesis.

Odometry, then inertia, is the "more straightforward method" of section 7.2: bundle adjustment without
dynamics; angular velocity by differences of its attitudes, centre of mass by the straight line of its path,
inertia by least squares on a constant angular momentum.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from polhode.backend.initialization.multistart import inertia_from_momentum
from polhode.backend.initialization.rates import interval_rates
from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import TIME_LIMIT, GaussNewton, NormalEquations
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.backend.solvers.solve import PASS_TOLERANCE
from polhode.compare.problem.assessment import reference_covariance
from polhode.compare.problem.measured_problem import MeasuredProblem, inertia_around, with_form
from polhode.compare.solver import AdapterResult, OutOfTime, SolveMonitor
from polhode.geometry.lie import Array

MAX_ITERATIONS = 500


class MonitoredGaussNewton(GaussNewton):
    """As in the last step of the back end, with its limit checked, each iterate recorded.

    ``common`` takes its unknowns to the common ones. Without dynamics its cost is not the common one.
    """

    def __init__(
        self,
        data: MotionData,
        monitor: SolveMonitor,
        common: Callable[[Array], Array] = lambda x: x,
        with_dynamics: bool = True,
    ) -> None:
        super().__init__(data, with_dynamics, line_search=with_dynamics)
        self.monitor, self.common = monitor, common

    def normal_equations(
        self, fixed: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        """Raises OutOfTime at the limit."""
        system = super().normal_equations(fixed, x, weight, prior)
        self.monitor.record(system.cost, self.common(x), common=self.with_dynamics)
        self.monitor.check()
        return system


@dataclass
class Ours:
    """Gauss-Newton in one form of the inertia."""

    form: str = "second_moments"

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Solve in the form's own coordinates, repeatedly until the cost is stationary (as
        ``backend.solvers.solve.refine``). The reference rotation of a form is renewed every few iterations.
        """
        own, common = problem, self.form == problem.data.form.name
        before, total, iterations = np.inf, 0, MAX_ITERATIONS if common else 12
        while True:
            if not common:
                own = with_form(problem, self.form, problem.iterate(x))
            solver = MonitoredGaussNewton(own.data, monitor, partial(_in_form, own, problem))
            found = solver.solve(own.fixed, _in_form(problem, own, x), iterations, max(monitor.left(), 0.0))
            x, total = _in_form(own, problem, found.x), total + found.iterations
            monitor.record(found.cost, x)
            if found.message == TIME_LIMIT:
                raise OutOfTime
            stationary = before - found.cost <= PASS_TOLERANCE * found.cost
            if (found.converged and stationary) or total >= MAX_ITERATIONS:
                break
            before = found.cost
        monitor.stop()
        cov = reference_covariance(problem, x) if common else None
        return AdapterResult(x, found.converged, total, found.message, cov)


def _in_form(before: MeasuredProblem, after: MeasuredProblem, x: Array) -> Array:
    """The same unknowns with the inertia in the other problem's coordinates."""
    if before is after:
        return x
    out, at = x.copy(), before.iterate(x)
    second = at.second_moments(before.data.form)
    out[at.n_states + 3 : at.n_states + 8] = inertia_around(second, after.data, after.fixed.reference)
    return out


class Odometry:
    """Bundle adjustment without dynamics, then least squares."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """One bundle adjustment, then rates, centre of mass and inertia."""
        data = problem.data
        solver = MonitoredGaussNewton(data, monitor, with_dynamics=False)
        found = solver.solve(problem.fixed, x, 100, max(monitor.left(), 0.0))
        monitor.check()
        at = problem.iterate(found.x)
        time_s = np.concatenate([[0.0], np.cumsum(data.dt_s)])
        between, _ = interval_rates(time_s, at.R_NG)
        # means of the differences before and after a frame
        w_G = 0.5 * (np.vstack([between[:1], between]) + np.vstack([between, between[-1:]]))
        J = inertia_from_momentum(at.R_NG, w_G)
        xi, R_inertia = data.form.coordinates(np.eye(3) if J is None else second_moments_from_inertia(J))
        com_G, v_N = straight_line(at, time_s)
        v_N = np.tile(v_N, (len(time_s), 1))
        motion = replace(at, v_N=v_N, w_G=w_G, com_G=com_G, xi=xi, R_inertia=R_inertia)
        message = found.message if J is not None else "no possible inertia fits: that of a sphere is taken"
        return AdapterResult(problem.vector(motion), found.converged, found.iterations, message)


def straight_line(at: Iterate, time_s: Array) -> tuple[Array, Array]:
    """com_G (3,) whose path p_NG + R_NG com_G is nearest to uniform motion, and its velocity (3,)."""
    F, eye = len(time_s), np.eye(3)
    rows = np.zeros((3 * F, 9))
    rows[:, 0:3] = -at.R_NG.reshape(-1, 3)
    rows[:, 3:6] = np.tile(eye, (F, 1))
    rows[:, 6:9] = (time_s[:, None, None] * eye).reshape(-1, 3)
    found = np.linalg.lstsq(rows, at.p_NG.ravel(), rcond=None)[0]
    return np.asarray(found[:3]), np.asarray(found[6:9])
