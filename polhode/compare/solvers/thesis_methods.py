"""The two methods of the thesis, as baselines.

*Dynamic iSAM* (chapters 4 and 6): frames are added one by one; after each, seven Gauss-Newton steps on all
frames so far with full relinearization (section 6.4). k1, k2 are free Gaussian variables of standard
deviation 3, the axes and the centre of mass have wide priors, the first landmark is fixed to a micrometre,
the first pose only weakly. A new frame starts at its prediction. Measurements, kernel and process noise are
those of the common cost.

Odometry, then inertia, the "more straightforward method" of section 7.2: bundle adjustment without dynamics;
angular velocity by differences of its attitudes, centre of mass by the straight line of its path, inertia by
least squares on a constant angular momentum.
"""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.dynamics.propagation import propagate_rotations, series_steps
from polhode.backend.dynamics.so3_exp import matrices_from_quaternions
from polhode.backend.initialization.multistart import inertia_from_momentum
from polhode.backend.initialization.rates import interval_rates
from polhode.backend.problem.inertia import (
    inertia_from_second_moments,
    rotation_sx,
    second_moments_from_inertia,
)
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import NormalEquations
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.compare.solvers.ours import MonitoredGaussNewton, TimedGaussNewton
from polhode.geometry.lie import Array, Ints, exp_so3, hat, log_so3, right_jacobian_so3

STEPS_A_FRAME = 7
PRIOR_SIGMA = np.array([0.5] * 3 + [3.0] * 2 + [40.0] * 3)
"""com_G [m], k1, k2, axes [rad]: an MRP of 10 (section 6.4) is 40 rad."""
LANDMARK_SIGMA_M = 1e-6
FIRST_POSE = (1.34, 16.0)
"""Standard deviations of the first pose [m, rad]."""


class DynamicIsam:
    """Incremental batch smoothing."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """The last estimate; the message states how often the inertia was impossible."""
        data = replace(problem.data, form=LogRatios())
        start = problem.iterate(x)
        second = start.second_moments(problem.data.form)
        xi, R_inertia = data.form.coordinates(second)
        first = replace(start, xi=xi, R_inertia=R_inertia)
        at, impossible, steps, seen = None, 0, 0, np.zeros(data.n_landmarks, dtype=bool)
        p_G = start.p_G.copy()
        fixed_landmark = int(data.landmark[data.frame == data.frame.min()][0])
        first_p_G = p_G[fixed_landmark].copy()
        monitor.report(f"none of {data.n_frames} frames were in")
        for n in range(2, data.n_frames + 1):
            at = _grown(at, first, n, data)
            small, landmarks = _first_frames(data, n)
            new = landmarks[~seen[landmarks]]
            # a new landmark is placed as the newest pose sees it: the first map in the G of that pose
            p_N = first.p_NG[n - 1] + start.p_G[new] @ first.R_NG[n - 1].T
            p_G[new] = (p_N - at.p_NG[n - 1]) @ at.R_NG[n - 1]
            seen[landmarks] = True
            begin = replace(at, p_G=p_G[landmarks])
            fixed = _fixed(problem.fixed, begin, small.R_RN)
            solver = _FixedLandmark(
                small, monitor, int(np.searchsorted(landmarks, fixed_landmark)), first_p_G
            )
            found = solver.solve(fixed, begin.vector(), STEPS_A_FRAME, max(monitor.left(), 0.0))
            ended = begin.moved_to(found.x)
            p_G[landmarks] = ended.p_G
            at = replace(ended, p_G=p_G)
            impossible += not possible(ended.xi)
            steps += found.iterations
            monitor.record(found.cost)
            monitor.report(f"{n} of {data.n_frames} frames were in")
            monitor.check()
        assert at is not None
        second = second_moments_from_inertia(inertia_from_second_moments(at.second_moments(data.form)))
        xi, R_inertia = problem.data.form.coordinates(second)
        end = replace(at, R_torque=start.R_torque, xi=xi, R_inertia=R_inertia)
        message = f"the inertia was impossible in {impossible} of {data.n_frames - 1} frames"
        return AdapterResult(problem.vector(end), True, steps, message)


class _FixedLandmark(TimedGaussNewton):
    """With the wide priors of the thesis and the first landmark fixed."""

    def __init__(self, data: MotionData, monitor: SolveMonitor, landmark: int, p_G: Array) -> None:
        super().__init__(data, monitor)
        self._landmark, self._p_G = landmark, p_G
        self._prior = wide_prior

    def cost(self, fixed: LinearizationPoint, x: Array) -> float:
        """With the prior of the fixed landmark."""
        offset = self._offset(fixed, x)
        return super().cost(fixed, x) + 0.5 * float(offset @ offset) / LANDMARK_SIGMA_M**2

    def normal_equations(
        self, fixed: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        """With the prior of the fixed landmark."""
        system = super().normal_equations(fixed, x, weight, prior)
        offset = self._offset(fixed, x)
        system.C[self._landmark] += np.eye(3) / LANDMARK_SIGMA_M**2
        system.h[self._landmark] += offset / LANDMARK_SIGMA_M**2
        return replace(system, cost=system.cost + 0.5 * float(offset @ offset) / LANDMARK_SIGMA_M**2)

    def _offset(self, fixed: LinearizationPoint, x: Array) -> Array:
        at = fixed.reference.n_dense + 3 * self._landmark
        return x[at : at + 3] - self._p_G


def wide_prior(x: Array, _: Array) -> tuple[float, Array, Array]:
    """Cost, gradient and Hessian, as ``WeakPrior`` of the back end."""
    gradient = x / PRIOR_SIGMA**2
    return 0.5 * float(x @ gradient), gradient, np.diag(PRIOR_SIGMA**-2.0)


def _grown(at: Iterate | None, first: Iterate, n: int, data: MotionData) -> Iterate:
    """n frames: the first two with their first poses, each further one predicted by the estimated motion."""
    if at is None:
        cut = _cut(first, n)
        turn = log_so3(cut.R_NG[0].T @ cut.R_NG[1]) / data.dt_s[0]
        return replace(cut, w_G=np.tile(turn, (n, 1)))
    dt_s = data.dt_s[n - 2 : n - 1]
    J_G = at.J_G(data.form)
    q, w_end, _, _ = propagate_rotations(
        at.w_G[-1:], J_G, dt_s, series_steps(at.w_G[-1:], J_G, dt_s, data.torque_psd)
    )
    R_NG = at.R_NG[-1] @ matrices_from_quaternions(q)[0]
    r_N = at.p_NG[-1] + at.R_NG[-1] @ at.com_G + dt_s * at.v_N[-1]
    if not (np.isfinite(R_NG).all() and np.isfinite(w_end).all()):
        R_NG, w_end = at.R_NG[-1], at.w_G[-1:]
    return replace(
        at,
        p_NG=np.vstack([at.p_NG, r_N - R_NG @ at.com_G]),
        R_NG=np.concatenate([at.R_NG, R_NG[None]]),
        v_N=np.vstack([at.v_N, at.v_N[-1]]),
        w_G=np.vstack([at.w_G, w_end]),
        camera=_cut(first, n).camera,
    )


def _cut(at: Iterate, n: int) -> Iterate:
    camera = None if at.camera is None else at.camera[:n]
    parts = {name: getattr(at, name)[:n] for name in ("p_NG", "R_NG", "v_N", "w_G")}
    return replace(at, **parts, camera=camera)


def _first_frames(data: MotionData, n: int) -> tuple[MotionData, Ints]:
    """Measurements of the first n frames, and the landmarks in them."""
    kept = data.frame < n
    landmarks, landmark = np.unique(data.landmark[kept], return_inverse=True)
    small = replace(
        data.select(kept, landmark.astype(np.int64), len(landmarks)),
        R_RN=data.R_RN[:n],
        t_R=data.t_R[:n],
        camera_N=data.camera_N[:n],
        dt_s=data.dt_s[: n - 1],
        nodes=data.nodes[: n - 1],
    )
    return small, landmarks


def _fixed(fixed: LinearizationPoint, reference: Iterate, R_RN: Array) -> LinearizationPoint:
    information = np.repeat([FIRST_POSE[0] ** -2.0, FIRST_POSE[1] ** -2.0], 3)
    return replace(
        fixed,
        reference=reference,
        A=R_RN @ reference.R_NG,
        steps=fixed.steps.part(slice(len(R_RN) - 1)),
        gauge_information=information,
    )


class LogRatios:
    """``xi = (k1, k2, eta)``: J = R diag(exp k1, 1, exp -k2) R^T with R = R_ref Exp(eta)."""

    name = "log_ratios"

    def second_moments_sx(self, xi: Any, R_ref: Any) -> Any:
        """Not scaled to determinant 1, which is impossible for an impossible body."""
        R = R_ref @ rotation_sx(xi[2:5])
        moments = ca.vertcat(ca.exp(xi[0]), 1.0, ca.exp(-xi[1]))
        return R @ ca.diag(0.5 * ca.sum1(moments) - moments) @ R.T

    def second_moments(self, xi: Array, R_ref: Array) -> Array:
        """(3, 3), perhaps not positive."""
        R = R_ref @ exp_so3(xi[2:5])
        return np.asarray(R @ np.diag(_second_moments(xi)) @ R.T)

    def derivative(self, xi: Array, R_ref: Array) -> Array:
        """(5, 3, 3)"""
        R, a, c = R_ref @ exp_so3(xi[2:5]), np.exp(xi[0]), np.exp(-xi[1])
        of_ratios = 0.5 * np.array([[-a, a, a], [-c, -c, c]])
        rotated = hat(right_jacobian_so3(xi[2:5]).T) @ np.diag(_second_moments(xi))
        slopes = np.concatenate([of_ratios[:, :, None] * np.eye(3), rotated + np.swapaxes(rotated, 1, 2)])
        return np.asarray(R @ slopes @ R.T)

    def coordinates(self, second: Array) -> tuple[Array, Array]:
        """Of a possible body."""
        moments, R = np.linalg.eigh(inertia_from_second_moments(second))
        moments, R = moments[::-1], R[:, ::-1]
        R = R * np.array([1.0, 1.0, np.linalg.det(R)])
        k1, k2 = np.log(moments[0] / moments[1]), np.log(moments[1] / moments[2])
        return np.array([k1, k2, 0.0, 0.0, 0.0]), R


def possible(xi: Array) -> bool:
    """Whether the moments satisfy the triangle inequality: all second moments are positive."""
    return bool(_second_moments(xi).min() > 0.0)


def _second_moments(xi: Array) -> Array:
    """(3,) along the principal axes, of moments exp(k1), 1, exp(-k2)."""
    moments = np.array([np.exp(xi[0]), 1.0, np.exp(-xi[1])])
    return np.asarray(0.5 * moments.sum() - moments)


class Odometry:
    """Bundle adjustment without dynamics, then least squares."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """One bundle adjustment, then rates, centre of mass and inertia."""
        data = problem.data
        solver = MonitoredGaussNewton(data, monitor, with_dynamics=False)
        found = solver.solve_in_time(problem.fixed, x, 100)
        at = problem.iterate(found.x)
        time_s = np.concatenate([[0.0], np.cumsum(data.dt_s)])
        between, _ = interval_rates(time_s, at.R_NG)
        # means of the differences before and after a frame
        w_G = 0.5 * (np.vstack([between[:1], between]) + np.vstack([between, between[-1:]]))
        J = inertia_from_momentum(at.R_NG, w_G)
        second = np.eye(3) if J is None else second_moments_from_inertia(J)
        xi, R_inertia = data.form.coordinates(second)
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
