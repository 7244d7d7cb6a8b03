"""Odometry, then inertia: the "more straightforward method" of thesis section 7.2.

Bundle adjustment knows nothing of dynamics; angular velocity by differences of its attitudes, centre of mass
by the straight line that it draws, inertia by least squares on a constant angular momentum.
"""

from dataclasses import replace

import numpy as np

from polhode.backend.initialization.multistart import inertia_from_momentum
from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.backend.problem.iterate import Iterate
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import Outcome, SolveMonitor
from polhode.compare.solvers.ours import MonitoredGaussNewton
from polhode.lie import Array, log_so3

MAX_ITERATIONS = 100


class Odometry:
    """No dynamics in the map."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """One bundle adjustment, then three least squares."""
        data = problem.data
        solver = MonitoredGaussNewton(data, monitor, with_dynamics=False)
        found = solver.solve(problem.held, x, MAX_ITERATIONS, max(monitor.left(), 0.0))
        monitor.check()
        at = problem.iterate(found.x)
        time_s = np.concatenate([[0.0], np.cumsum(data.dt_s)])
        w_G = rates(at.R_NG, data.dt_s)
        J = inertia_from_momentum(at.R_NG, w_G)
        second = np.eye(3) if J is None else second_moments_from_inertia(J)
        xi, R_inertia = data.form.coordinates(second)
        com_G, v_N = straight_line(at, time_s)
        motion = replace(
            at, v_N=np.tile(v_N, (len(time_s), 1)), w_G=w_G, com_G=com_G, xi=xi, R_inertia=R_inertia
        )
        message = "no possible inertia fits the rates: a sphere" if J is None else found.message
        return Outcome(problem.vector(motion), found.converged, found.iterations, message)


def rates(R_NG: Array, dt_s: Array) -> Array:
    """Angular velocity (F, 3) in G: means of the differences before and after."""
    between = log_so3(np.swapaxes(R_NG[:-1], 1, 2) @ R_NG[1:]) / dt_s[:, None]
    padded = np.concatenate([between[:1], between, between[-1:]])
    return np.asarray(0.5 * (padded[:-1] + padded[1:]))


def straight_line(at: Iterate, time_s: Array) -> tuple[Array, Array]:
    """com_G (3,) whose path p_NG + R_NG com_G is nearest to a straight line, and its velocity (3,)."""
    F, eye = len(time_s), np.eye(3)
    rows = np.zeros((3 * F, 9))
    rows[:, 0:3] = -at.R_NG.reshape(-1, 3)
    rows[:, 3:6] = np.tile(eye, (F, 1))
    rows[:, 6:9] = (time_s[:, None, None] * eye).reshape(-1, 3)
    found = np.linalg.lstsq(rows, at.p_NG.ravel(), rcond=None)[0]
    return np.asarray(found[:3]), np.asarray(found[6:9])
