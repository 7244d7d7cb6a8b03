"""GTSAM: Levenberg-Marquardt on the whole graph, and iSAM2 frame by frame."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, V, X

from polhode.backend.dynamics.so3_exp import inverse_right_jacobians
from polhode.compare.problem.blocks import Blocks, Evaluation, SingleBlocks
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array, hat, inverse_pose, log_so3, make_pose

TOLERANCE = 1e-10
MAX_ITERATIONS = 300
RELINEARIZE, WILDFIRE = 1e-5, 1e-8
"""Smallest change of an unknown for which iSAM2 relinearizes, and that it propagates."""
LAST_UPDATES = 40
NOT_SEPARABLE = "GTSAM evaluates its stereo factors in C++ inside its own steps"


class Batch:
    """Levenberg-Marquardt with Marquardt's scaling."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Until the relative decrease is below TOLERANCE."""
        monitor.not_separable = NOT_SEPARABLE
        with monitor.part("build"):
            own = Graph(problem, monitor)
            graph, values = own.all(x), own.values(x)
            parameters = gtsam.LevenbergMarquardtParams()
            parameters.setDiagonalDamping(True)
            parameters.setlambdaUpperBound(1e12)
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
        before, converged, iterations = optimizer.error(), False, 0
        monitor.record(before, x)
        while iterations < MAX_ITERATIONS and not converged:
            optimizer.iterate()
            iterations += 1
            after = optimizer.error()
            monitor.record(after, own.vector(optimizer.values()))
            monitor.check()
            converged = before - after <= TOLERANCE * after
            before = after
        values = optimizer.values()
        return _ended(own, values, converged, iterations, lambda: gtsam.Marginals(graph, values))


class Incremental:
    """iSAM2: frames are added one by one, from the same start; then updates until the cost is stationary."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """The cost is recorded once all frames have been added."""
        monitor.not_separable = NOT_SEPARABLE
        with monitor.part("build"):
            own = Graph(problem, monitor)
            # small steps must reach every unknown, or the cost is stationary too early
            parameters = gtsam.ISAM2Params()
            parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(WILDFIRE))
            parameters.setRelinearizeThreshold(RELINEARIZE)
            parameters.relinearizeSkip = 1
            isam = gtsam.ISAM2(parameters)
        d, seen, iterations = problem.data, np.zeros(problem.data.n_landmarks, dtype=bool), 0
        monitor.report(f"none of {d.n_frames} frames were in")
        for k in range(d.n_frames):
            new = gtsam.NonlinearFactorGraph()
            own.add_stereo(new, k)
            if k > 0:
                own.add_step(new, k - 1)
            else:
                own.add_others(new, x)
            landmarks = np.unique(d.landmark[d.frame == k])
            values = own.values(x, range(k, k + 1), landmarks[~seen[landmarks]])
            seen[landmarks] = True
            isam.update(new, values)
            iterations += 1
            monitor.report(f"{k + 1} of {d.n_frames} frames were in")
            monitor.check()
        monitor.report("")
        cost, converged = np.inf, False
        for _ in range(LAST_UPDATES):
            values = isam.calculateEstimate()
            found = own.vector(values)
            after = own.blocks.cost(found)
            monitor.record(after, found)
            converged = bool(abs(cost - after) <= TOLERANCE * after)
            if converged:
                break
            cost = after
            isam.update()
            iterations += 1
            monitor.check()
        return _ended(own, values, converged, iterations, lambda: isam)


def _ended(
    own: "Graph", values: Any, converged: bool, iterations: int, solved: Callable[[], Any]
) -> AdapterResult:
    """With the covariance (8, 8) of com_G, xi by GTSAM; None for a singular Hessian."""
    cov = None
    if own.monitor.stop():
        with suppress(RuntimeError):
            cov = np.asarray(solved().marginalCovariance(C(0)))[:8, :8]
    message = "converged" if converged else "limit of iterations"
    return AdapterResult(own.vector(values), converged, iterations, message, cov)


class Graph:
    """Factors by frame, and conversion of values from and to the common vector."""

    def __init__(self, problem: MeasuredProblem, monitor: SolveMonitor) -> None:
        self.blocks, self.monitor = Blocks(problem.data, problem.fixed), monitor
        self.data, self.fixed = problem.data, problem.fixed
        self.X_NR = inverse_pose(make_pose(self.data.R_RN, self.data.t_R))
        self._single = SingleBlocks(self.blocks)
        f, cx, cy, baseline, self._offset = self.data.rig
        self._camera = gtsam.Cal3_S2Stereo(f, f, 0.0, cx, cy, baseline)

    def all(self, x: Array) -> Any:
        """Every factor."""
        graph = gtsam.NonlinearFactorGraph()
        for k in range(self.data.n_frames):
            self.add_stereo(graph, k)
            if k > 0:
                self.add_step(graph, k - 1)
        self.add_others(graph, x)
        return graph

    def add_stereo(self, graph: Any, k: int) -> None:
        """Measurements of frame k."""
        d, T = self.data, np.array([[1.0, 0.0, 0.0], [1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(d.robust_scale)
        for m in np.flatnonzero(d.frame == k):
            u, v, disparity = d.uvd_px[m]
            measured = gtsam.StereoPoint2(u, u - (disparity - self._offset), v)
            base = gtsam.noiseModel.Gaussian.Covariance(T @ np.diag(d.inv_sigma[m] ** -2.0) @ T.T)
            model, keys = gtsam.noiseModel.Robust.Create(kernel, base), (X(k), L(int(d.landmark[m])))
            graph.add(gtsam.GenericStereoFactor3D(measured, model, *keys, self._camera, False, False))

    def add_step(self, graph: Any, k: int) -> None:
        """Dynamics from frame k to the next."""
        self._add(graph, [X(k), V(k), X(k + 1), V(k + 1), C(0)], 12, self._single.step(k))

    def add_others(self, graph: Any, x: Array) -> None:
        """Prior, gauge of the first pose, errors of the camera, prior of a known wrench."""
        b, s = self.blocks, self.blocks.n_state
        for kind, block in enumerate(b.others(x)):
            for row, slots in enumerate(block.slots):
                first = int(slots[0])
                if first >= b.n_states:
                    key, start, size = C(0), b.n_states, b.n_dense - b.n_states
                elif first % s < 6:
                    key, start, size = X(first // s), first, 6
                else:
                    key, start, size = V(first // s), first - first % s + 6, s - 6
                prior = self._single.prior(kind, row, x, np.arange(start, start + size))
                self._add(graph, [key], block.residual.shape[1], prior)

    def _add(self, graph: Any, keys: list[int], rows: int, evaluate: Evaluation) -> None:
        """A factor in Python; its Jacobian is converted to the tangent space of GTSAM's poses."""

        def call(this: Any, values: Any, jacobians: Any) -> Array:
            with self.monitor.callback(), np.errstate(all="ignore"):
                own, tangents = [], []
                for key in list(this.keys()):
                    numbers, tangent = self._numbers(values, key)
                    own.append(numbers)
                    tangents.append(tangent)
                residual, jacobian = evaluate(np.concatenate(own), jacobians is not None)
                if jacobians is not None:
                    start = 0
                    for n, (numbers, tangent) in enumerate(zip(own, tangents, strict=True)):
                        part = jacobian[:, start : start + len(numbers)]
                        jacobians[n] = np.asfortranarray(part if tangent is None else part @ tangent)
                        start += len(numbers)
                # GTSAM accepts steps to NaN
                return np.where(np.isfinite(residual), residual, 1e30)

        graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), keys, call))

    def _numbers(self, values: Any, key: int) -> tuple[Array, Array | None]:
        """Common unknowns of a key; of a pose, their derivative (6, 6) in GTSAM's tangent space."""
        symbol = gtsam.Symbol(key)
        if chr(symbol.chr()) != "x":
            return np.asarray(values.atVector(key)), None
        k = symbol.index()
        X_GR = values.atPose3(key).matrix()
        X_NG = self.X_NR[k] @ inverse_pose(X_GR)
        R_NG, R_GR = X_NG[:3, :3], X_GR[:3, :3]
        theta = log_so3(self.fixed.reference.R_NG[k].T @ R_NG)
        tangent = np.zeros((6, 6))
        tangent[:3, :3], tangent[:3, 3:] = -R_NG @ hat(X_GR[:3, 3]) @ R_GR, -R_NG @ R_GR
        tangent[3:, :3] = -inverse_right_jacobians(theta[None])[0] @ R_GR
        return np.concatenate([X_NG[:3, 3], theta]), tangent

    def values(self, x: Array, frames: range | None = None, landmarks: Any = None) -> Any:
        """GTSAM's values of frames and landmarks (all by default); constants with frame 0."""
        b, out = self.blocks, gtsam.Values()
        at = self.fixed.reference.moved_to(x)
        X_GR = inverse_pose(make_pose(at.R_NG, at.p_NG)) @ self.X_NR
        states = x[: b.n_states].reshape(-1, b.n_state)
        frames = range(self.data.n_frames) if frames is None else frames
        for k in frames:
            out.insert(X(k), gtsam.Pose3(X_GR[k]))
            out.insert(V(k), states[k, 6:].copy())
        if 0 in frames:
            out.insert(C(0), x[b.n_states : b.n_dense].copy())
        for landmark in range(self.data.n_landmarks) if landmarks is None else landmarks:
            out.insert(L(int(landmark)), at.p_G[landmark].copy())
        return out

    def vector(self, values: Any) -> Array:
        """The common unknowns (n,)."""
        b = self.blocks
        states = np.zeros((self.data.n_frames, b.n_state))
        for k in range(self.data.n_frames):
            states[k, :6] = self._numbers(values, X(k))[0]
            states[k, 6:] = values.atVector(V(k))
        landmarks = np.array([values.atPoint3(L(landmark)) for landmark in range(self.data.n_landmarks)])
        return np.concatenate([states.ravel(), values.atVector(C(0)), landmarks.ravel()])
