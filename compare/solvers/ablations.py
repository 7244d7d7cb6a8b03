"""Variants of the formulation, solved by polhode's Gauss-Newton and assessed by the common cost.

``log_ratios``: the thesis's k1, k2 with axes and its wide prior. ``constant_noise``: the process noise of a
body at rest, not along its motion. ``open_loop``: a landmark that comes back into view is a new one.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from polhode.backend.dynamics.process_noise import whitening
from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.compare.solvers.ours import MonitoredGaussNewton
from polhode.compare.solvers.thesis_methods import LogRatios, in_common, possible, wide_prior
from polhode.lie import Array
from polhode.records import Ints

MAX_ITERATIONS = 300
ABSENT = 2
"""Frames without a landmark after which it counts as a new one."""


@dataclass
class Ablation:
    """One variant."""

    variant: str

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """The variant's optimum, in the common unknowns."""
        if self.variant == "log_ratios":
            return _log_ratios(problem, x, monitor)
        if self.variant == "constant_noise":
            fixed = replace(problem.fixed, steps=_at_rest(problem))
            found = MonitoredGaussNewton(problem.data, monitor).solve_in_time(fixed, x, MAX_ITERATIONS)
            return AdapterResult(found.x, found.converged, found.iterations, found.message)
        return _open_loop(problem, x, monitor)


class _WidePrior(MonitoredGaussNewton):
    """With the prior of the thesis."""

    def __init__(self, data: MotionData, monitor: SolveMonitor, common: Callable[[Array], Array]) -> None:
        super().__init__(data, monitor, common)
        self._prior = wide_prior


def _at_rest(problem: MeasuredProblem) -> Steps:
    data = problem.data
    still = np.zeros((len(data.dt_s), 3))
    levels = np.full(len(data.dt_s), data.accel_psd), np.full(len(data.dt_s), data.torque_psd)
    W_t, W_r, _ = whitening(still, np.eye(3), data.dt_s, *levels)
    return replace(problem.fixed.steps, W_t=W_t, W_r=W_r)


def _log_ratios(problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
    data = replace(problem.data, form=LogRatios())
    start = problem.iterate(x)
    xi, R_inertia = data.form.coordinates(start.second_moments(problem.data.form))
    begin = replace(start, xi=xi, R_inertia=R_inertia)
    total, before = 0, np.inf
    while True:
        # references are renewed, as the axes of nearly equal moments rotate far
        solver = _WidePrior(data, monitor, partial(_moved, problem, data, begin))
        fixed = _around(problem.fixed, data, begin)
        found = solver.solve_in_time(fixed, begin.vector(), 15)
        total, begin = total + found.iterations, begin.moved_to(found.x)
        stationary = before - found.cost <= 1e-8 * found.cost
        if (found.converged and stationary) or total >= MAX_ITERATIONS:
            break
        before = found.cost
    body = "a possible body" if possible(begin.xi) else "an impossible body"
    end = in_common(problem, data, begin)
    return AdapterResult(end, found.converged, total, f"{found.message}; {body}")


def _moved(problem: MeasuredProblem, data: MotionData, at: Iterate, x: Array) -> Array:
    return in_common(problem, data, at.moved_to(x))


def _around(fixed: LinearizationPoint, data: MotionData, at: Iterate) -> LinearizationPoint:
    return replace(fixed, reference=at, A=data.R_RN @ at.R_NG)


def passages(data: MotionData) -> tuple[Ints, Ints]:
    """(M,) landmark of each observation, new after an absence, and the old landmark of each new one."""
    new, old, number = np.empty(len(data.frame), dtype=np.int64), [], -1
    for landmark in range(data.n_landmarks):
        at = np.arange(data.start[landmark], data.start[landmark + 1])
        for m, gap in zip(at, np.diff(data.frame[at], prepend=-(10**6)), strict=True):
            if gap > ABSENT:
                number += 1
                old.append(landmark)
            new[m] = number
    return new, np.array(old, dtype=np.int64)


def _open_loop(problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
    data, at = problem.data, problem.fixed.reference
    new, old = passages(data)
    split = replace(data, landmark=new, start=np.searchsorted(new, np.arange(len(old) + 1)).astype(np.int64))
    landmarks = x[at.n_dense :].reshape(-1, 3)
    start = np.concatenate([x[: at.n_dense], landmarks[old].ravel()])
    fixed = replace(problem.fixed, reference=replace(at, p_G=at.p_G[old]))
    # a landmark is represented by its first passage
    first = np.searchsorted(old, np.arange(data.n_landmarks))

    def common(z: Array) -> Array:
        return np.concatenate([z[: at.n_dense], z[at.n_dense :].reshape(-1, 3)[first].ravel()])

    found = MonitoredGaussNewton(split, monitor, common).solve_in_time(fixed, start, MAX_ITERATIONS)
    message = f"{found.message}; {data.n_landmarks} landmarks became {len(old)}"
    return AdapterResult(common(found.x), found.converged, found.iterations, message)
