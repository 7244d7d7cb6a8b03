"""*Dynamic iSAM*, the thesis's own way (chapters 4 and 6), as a baseline whose shortcomings are measured.

Frames come one by one; after each, seven Gauss-Newton steps of everything so far with full relinearisation
(section 6.4). k1, k2 are free Gaussian numbers of standard deviation 3, the axes and the centre of mass have
wide priors, the first landmark is locked to a micrometre, the first pose hardly held. A new frame begins
where the estimated motion leads. Measurements, kernel and process noise are those of the common cost.
"""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.dynamics.propagation import propagate_rotations, series_steps
from polhode.backend.dynamics.so3_exp import matrices_from_quaternions
from polhode.backend.problem.inertia import (
    inertia_from_second_moments,
    rotation_sx,
    second_moments_from_inertia,
)
from polhode.backend.problem.iterate import N_CONSTANTS, Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import NormalEquations
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.problem.single_blocks import first_steps
from polhode.compare.solver import Outcome, SolveMonitor
from polhode.compare.solvers.ours import TimedGaussNewton
from polhode.lie import Array, exp_so3, hat, log_so3, right_jacobian_so3
from polhode.records import Ints

STEPS_A_FRAME = 7
PRIOR_SIGMA = np.array([0.5] * 3 + [3.0] * 2 + [40.0] * 3)
"""com_G [m], k1, k2, axes [rad]: MRP of 10 (section 6.4) are 40 rad."""
LOCK_M = 1e-6
FIRST_POSE = (1.34, 16.0)
"""m, rad: standard deviations of the first pose."""
MIN_FRAMES = 2


class DynamicIsam:
    """Incremental batch smoothing."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """The last estimate; the message tells how often the inertia was impossible."""
        data = replace(problem.data, form=LogRatios())
        start = problem.iterate(x)
        second = start.second_moments(problem.data.form)
        xi, R_inertia = data.form.coordinates(second)
        first = replace(start, xi=xi, R_inertia=R_inertia)
        at, impossible, steps, seen = None, 0, 0, np.zeros(data.n_landmarks, dtype=bool)
        p_G = start.p_G.copy()
        locked = int(data.landmark[data.frame == data.frame.min()][0])
        lock = p_G[locked].copy()
        for n in range(MIN_FRAMES, data.n_frames + 1):
            at = _grown(at, first, n, data)
            small, marks = _first_frames(data, n)
            fresh = marks[~seen[marks]]
            # a new landmark is put where the newest pose sees it
            p_G[fresh] = _carried(first, at, n - 1, start.p_G[fresh])
            seen[marks] = True
            begin = replace(at, p_G=p_G[marks])
            held = _held(problem.held, begin, small.R_RN)
            solver = _Locked(small, monitor, int(np.searchsorted(marks, locked)), lock)
            found = solver.solve(held, begin.vector(), STEPS_A_FRAME, max(monitor.left(), 0.0))
            ended = begin.moved_to(found.x)
            p_G[marks] = ended.p_G
            at = replace(ended, p_G=p_G)
            impossible += not possible(ended.xi)
            steps += found.iterations
            monitor.note(found.cost)
            monitor.tell(f"{n} of {data.n_frames} frames were in")
            monitor.check()
        assert at is not None
        second = second_moments_from_inertia(inertia_from_second_moments(at.second_moments(data.form)))
        xi, R_inertia = problem.data.form.coordinates(second)
        end = replace(at, xi=xi, R_inertia=R_inertia, R_torque=start.R_torque)
        frames = data.n_frames - MIN_FRAMES + 1
        message = f"the inertia was an impossible body's in {impossible} of {frames} frames"
        return Outcome(problem.vector(end), True, steps, message)


class _Locked(TimedGaussNewton):
    """Wide priors of the thesis, the first landmark locked."""

    def __init__(self, data: MotionData, monitor: SolveMonitor, mark: int, lock: Array) -> None:
        super().__init__(data, monitor)
        self._mark, self._lock = mark, lock
        self._prior = wide_prior

    def cost(self, held: LinearizationPoint, x: Array) -> float:
        """With the lock's."""
        offset = self._offset(held, x)
        return super().cost(held, x) + 0.5 * float(offset @ offset) / LOCK_M**2

    def normal_equations(
        self, held: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        """With the lock's."""
        system = super().normal_equations(held, x, weight, prior)
        offset = self._offset(held, x)
        system.C[self._mark] += np.eye(3) / LOCK_M**2
        system.h[self._mark] += offset / LOCK_M**2
        return replace(system, cost=system.cost + 0.5 * float(offset @ offset) / LOCK_M**2)

    def _offset(self, held: LinearizationPoint, x: Array) -> Array:
        at = held.reference.n_dense + 3 * self._mark
        return x[at : at + 3] - self._lock


def wide_prior(x: Array, _: Array) -> tuple[float, Array, Array]:
    """Cost, gradient, upper Hessian by columns, as the kernel that it stands for."""
    gradient = x / PRIOR_SIGMA**2
    cols, rows = np.tril_indices(N_CONSTANTS)
    return 0.5 * float(x @ gradient), gradient, np.diag(PRIOR_SIGMA**-2.0)[rows, cols]


def _grown(at: Iterate | None, first: Iterate, n: int, data: MotionData) -> Iterate:
    """n frames: the first two as the first poses have them, another as the estimated motion goes on."""
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


def _carried(first: Iterate, at: Iterate, k: int, p_G: Array) -> Array:
    """Points of the first map as frame k of ``at`` sees them."""
    p_N = first.p_NG[k] + p_G @ first.R_NG[k].T
    return np.asarray((p_N - at.p_NG[k]) @ at.R_NG[k])


def _first_frames(data: MotionData, n: int) -> tuple[MotionData, Ints]:
    """Measurements of the first n frames, and which landmarks they show."""
    kept = data.frame < n
    marks, landmark = np.unique(data.landmark[kept], return_inverse=True)
    landmark = landmark.astype(np.int64)
    small = replace(
        data,
        frame=data.frame[kept],
        landmark=landmark,
        start=np.searchsorted(landmark, np.arange(len(marks) + 1)).astype(np.int64),
        uvd_px=data.uvd_px[kept],
        inv_sigma=data.inv_sigma[kept],
        order=data.order[kept],
        R_RN=data.R_RN[:n],
        t_R=data.t_R[:n],
        camera_N=data.camera_N[:n],
        dt_s=data.dt_s[: n - 1],
        nodes=data.nodes[: n - 1],
    )
    return small, marks


def _held(held: LinearizationPoint, reference: Iterate, R_RN: Array) -> LinearizationPoint:
    information = np.repeat([FIRST_POSE[0] ** -2.0, FIRST_POSE[1] ** -2.0], 3)
    return replace(
        held,
        reference=reference,
        A=R_RN @ reference.R_NG,
        steps=first_steps(held.steps, len(R_RN) - 1),
        gauge_information=information,
    )


class LogRatios:
    """``xi = (k1, k2, eta)``: J = R diag(exp k1, 1, exp -k2) R^T with R = R_ref Exp(eta)."""

    name = "log_ratios"

    def second_moments_sx(self, xi: Any, R_ref: Any) -> Any:
        """Not scaled to determinant 1, which an impossible body has none of."""
        R = R_ref @ rotation_sx(xi[2:5])
        moments = ca.vertcat(ca.exp(xi[0]), 1.0, ca.exp(-xi[1]))
        return R @ ca.diag(0.5 * ca.sum1(moments) - moments) @ R.T

    def second_moments(self, xi: Array, R_ref: Array) -> Array:
        """(3, 3), perhaps not positive."""
        R, moments = R_ref @ exp_so3(xi[2:5]), _moments(xi)
        return np.asarray(R @ np.diag(0.5 * moments.sum() - moments) @ R.T)

    def derivative(self, xi: Array, R_ref: Array) -> Array:
        """(5, 3, 3)"""
        R, moments = R_ref @ exp_so3(xi[2:5]), _moments(xi)
        d = 0.5 * moments.sum() - moments
        a, c = moments[0], moments[2]
        out = np.empty((5, 3, 3))
        out[0] = R @ np.diag([-0.5 * a, 0.5 * a, 0.5 * a]) @ R.T
        out[1] = R @ np.diag([-0.5 * c, -0.5 * c, 0.5 * c]) @ R.T
        turned = hat(right_jacobian_so3(xi[2:5]).T) @ np.diag(d)
        out[2:] = R @ (turned + np.swapaxes(turned, 1, 2)) @ R.T
        return out

    def coordinates(self, second: Array) -> tuple[Array, Array]:
        """Of a possible body."""
        moments, R = np.linalg.eigh(inertia_from_second_moments(second))
        moments, R = moments[::-1], R[:, ::-1]
        R = R * np.array([1.0, 1.0, np.linalg.det(R)])
        k1, k2 = np.log(moments[0] / moments[1]), np.log(moments[1] / moments[2])
        return np.array([k1, k2, 0.0, 0.0, 0.0]), R


def possible(xi: Array) -> bool:
    """Whether the moments obey the triangle inequality."""
    moments = _moments(xi)
    return bool(2.0 * moments.max() < moments.sum())


def _moments(xi: Array) -> Array:
    return np.array([np.exp(xi[0]), 1.0, np.exp(-xi[1])])
