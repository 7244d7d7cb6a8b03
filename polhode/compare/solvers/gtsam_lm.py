"""GTSAM: Levenberg-Marquardt on a graph of its own stereo factors and of our blocks in Python."""

from contextlib import suppress
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, V, X

from polhode.backend.dynamics.so3_exp import inverse_right_jacobians
from polhode.compare.problem.blocks import Blocks, Evaluation
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array, hat, inverse_pose, log_so3, make_pose

TOLERANCE = 1e-10
MAX_ITERATIONS = 300


class LevenbergMarquardt:
    """With Marquardt's scaling."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Until the relative decrease is below TOLERANCE."""
        own = Graph(problem)
        graph, values = own.factors(x), own.values(x)
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
        values, cov = optimizer.values(), None
        if monitor.stop():
            # none for a singular Hessian
            with suppress(RuntimeError):
                cov = np.asarray(gtsam.Marginals(graph, values).marginalCovariance(C(0)))[:8, :8]
        message = "converged" if converged else "limit of iterations"
        return AdapterResult(own.vector(values), converged, iterations, message, cov)


class Graph:
    """Factors, and conversion of values from and to the common vector."""

    def __init__(self, problem: MeasuredProblem) -> None:
        self.blocks = Blocks(problem.data, problem.fixed)
        self.data, self.fixed = problem.data, problem.fixed
        self.X_NR = inverse_pose(make_pose(self.data.R_RN, self.data.t_R))

    def factors(self, x: Array) -> Any:
        """Every factor: stereo, dynamics, then priors, gauge and errors of the camera."""
        graph, b, s = gtsam.NonlinearFactorGraph(), self.blocks, self.blocks.n_state
        d, T = self.data, np.array([[1.0, 0.0, 0.0], [1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(d.robust_scale)
        f, cx, cy, baseline, offset = d.rig
        camera = gtsam.Cal3_S2Stereo(f, f, 0.0, cx, cy, baseline)
        for m, k in enumerate(d.frame.tolist()):
            u, v, disparity = d.uvd_px[m]
            measured = gtsam.StereoPoint2(u, u - (disparity - offset), v)
            base = gtsam.noiseModel.Gaussian.Covariance(T @ np.diag(d.inv_sigma[m] ** -2.0) @ T.T)
            model, keys = gtsam.noiseModel.Robust.Create(kernel, base), (X(k), L(int(d.landmark[m])))
            graph.add(gtsam.GenericStereoFactor3D(measured, model, *keys, camera, False, False))
        for k in range(d.n_frames - 1):
            self._add(graph, [X(k), V(k), X(k + 1), V(k + 1), C(0)], 12, b.step(k))
        for kind, block in enumerate(b.others(x)):
            for row, slots in enumerate(block.slots):
                first = int(slots[0])
                if first >= b.n_states:
                    key, start, size = C(0), b.n_states, b.n_dense - b.n_states
                elif first % s < 6:
                    key, start, size = X(first // s), first, 6
                else:
                    key, start, size = V(first // s), first - first % s + 6, s - 6
                prior = b.prior(kind, row, x, np.arange(start, start + size))
                self._add(graph, [key], block.residual.shape[1], prior)
        return graph

    def _add(self, graph: Any, keys: list[int], rows: int, evaluate: Evaluation) -> None:
        """A factor in Python; its Jacobian is converted to the tangent space of GTSAM's poses."""

        def call(this: Any, values: Any, jacobians: Any) -> Array:
            with np.errstate(all="ignore"):
                own, tangents = zip(*(self._numbers(values, key) for key in list(this.keys())), strict=True)
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

    def values(self, x: Array) -> Any:
        """GTSAM's values of x (n,)."""
        b, out, at = self.blocks, gtsam.Values(), self.fixed.reference.moved_to(x)
        X_GR = inverse_pose(make_pose(at.R_NG, at.p_NG)) @ self.X_NR
        states = x[: b.n_states].reshape(-1, b.n_state)
        for k in range(self.data.n_frames):
            out.insert(X(k), gtsam.Pose3(X_GR[k]))
            out.insert(V(k), states[k, 6:].copy())
        out.insert(C(0), x[b.n_states : b.n_dense].copy())
        for landmark in range(self.data.n_landmarks):
            out.insert(L(landmark), at.p_G[landmark].copy())
        return out

    def vector(self, values: Any) -> Array:
        """The common unknowns (n,)."""
        states = np.zeros((self.data.n_frames, self.blocks.n_state))
        for k in range(self.data.n_frames):
            states[k, :6] = self._numbers(values, X(k))[0]
            states[k, 6:] = values.atVector(V(k))
        landmarks = np.array([values.atPoint3(L(landmark)) for landmark in range(self.data.n_landmarks)])
        return np.concatenate([states.ravel(), values.atVector(C(0)), landmarks.ravel()])
