"""Ceres through pyceres: blocks of the common cost as cost functions.

pyceres calls a Python function for every block, so that all measurements of a landmark are one block
(``landmark_block``).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pyceres

from polhode.compare.problem.blocks import Blocks, Evaluation, compile_block, landmark_block
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array

TOLERANCE = 1e-10
MAX_ITERATIONS = 500
Evaluate = Callable[[list[Array], list[Array | None] | None], Array]
"""(Parameters, arrays to fill with the Jacobians) -> residuals."""


class Ceres:
    """Levenberg-Marquardt, landmarks eliminated by Ceres's own Schur complement."""

    def __init__(self) -> None:
        """Load the compiled loop before the clock starts."""
        compile_block()

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Levenberg-Marquardt to a relative decrease of TOLERANCE."""
        graph = _Graph(problem, x)
        options = pyceres.SolverOptions()
        options.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
        options.max_num_iterations = MAX_ITERATIONS
        options.function_tolerance = TOLERANCE
        options.gradient_tolerance = options.parameter_tolerance = 1e-12
        options.max_solver_time_in_seconds = max(monitor.left(), 0.1)
        options.num_threads = 1
        options.logging_type = pyceres.LoggingType.SILENT
        options.update_state_every_iteration = True
        callback = _OnIteration(graph, monitor)
        options.callbacks = [callback]
        summary = pyceres.SolverSummary()
        pyceres.solve(options, graph.problem, summary)
        converged = summary.termination_type == pyceres.TerminationType.CONVERGENCE
        if not converged:
            monitor.check()
        cov = graph.covariance() if monitor.stop() and converged else None
        iterations = len(monitor.trace) - 1
        return AdapterResult(np.concatenate(graph.values), converged, iterations, str(summary.message), cov)


class _Graph:
    """Ceres's problem: parameter blocks are poses, other components of states, constants, landmarks."""

    def __init__(self, problem: MeasuredProblem, x: Array) -> None:
        self.problem, d = pyceres.Problem(), problem.data
        self.blocks = b = Blocks(d, problem.fixed)
        parts: list[slice] = []
        for start in range(0, b.n_states, b.n_state):
            parts += [slice(start, start + 6), slice(start + 6, start + b.n_state)]
        self.constants = len(parts)
        parts.append(slice(b.n_states, b.n_dense))
        parts += [slice(at, at + 3) for at in range(b.n_dense, len(x), 3)]
        # Ceres keeps their addresses and writes to them, so they are copies of x
        self.values = [x[part].copy() for part in parts]
        self._costs: list[Any] = []
        for landmark in range(d.n_landmarks):
            at = slice(d.start[landmark], d.start[landmark + 1])
            seen = d.frame[at]
            data = problem.fixed.A[seen], d.R_RN[seen], d.t_R[seen], d.uvd_px[at], d.inv_sigma[at], d.rig
            owners = [self.constants + 1 + landmark, *(2 * seen).tolist()]
            self._add(_of_landmark(data, d.robust_scale), 3 * len(seen), owners)
        for k in range(d.n_frames - 1):
            self._add(_of_block(b.step(k)), 12, [*range(2 * k, 2 * k + 4), self.constants])
        # priors: linear or small, evaluated with the unknowns of other blocks at the start
        owner = np.repeat(np.arange(len(parts)), [len(each) for each in self.values])
        for kind, block in enumerate(b.others(x)):
            for row in range(len(block.residual)):
                owners = list(dict.fromkeys(owner[block.slots[row]].tolist()))
                slots = np.concatenate([np.r_[parts[owner]] for owner in owners])
                self._add(_of_block(b.prior(kind, row, x, slots)), block.residual.shape[1], owners)

    def _add(self, evaluate: Evaluate, rows: int, owners: list[int]) -> None:
        cost = _CostFunction(evaluate, rows, [len(self.values[owner]) for owner in owners])
        self._costs.append(cost)
        self.problem.add_residual_block(cost, None, [self.values[owner] for owner in owners])

    def covariance(self) -> Array | None:
        """(8, 8) of com_G, xi by Ceres."""
        constants = self.values[self.constants]
        options = pyceres.CovarianceOptions()
        options.num_threads = 1
        found = pyceres.Covariance(options)
        if not found.compute([(constants, constants)], self.problem):
            return None
        return np.asarray(found.get_covariance_block(constants, constants))[:8, :8]


def _of_landmark(data: tuple[Array, Array, Array, Array, Array, Array], scale: float) -> Evaluate:
    """data: A_ref, R_RN, t_R, uvd, 1 / sigma of a landmark's measurements, rig."""
    n = len(data[0])
    of_poses, of_landmark = np.empty((n, 3, 6)), np.empty((n, 3, 3))

    def evaluate(parameters: list[Array], out: list[Array | None] | None) -> Array:
        poses = np.array(parameters[1:])
        residual = landmark_block(poses, np.array(parameters[0]), *data, scale, of_poses, of_landmark)
        for m, target in enumerate(out or []):
            if target is None:
                continue
            if m == 0:
                target[:] = of_landmark.ravel()
                continue
            # rows of the other frames do not depend on this pose
            target[:] = 0.0
            target[18 * m - 18 : 18 * m] = of_poses[m - 1].ravel()
        return residual.ravel()

    return evaluate


def _of_block(block: Evaluation) -> Evaluate:
    def evaluate(parameters: list[Array], out: list[Array | None] | None) -> Array:
        residual, jacobian = block(np.concatenate(parameters), out is not None)
        if out is not None:
            ends = np.cumsum([len(each) for each in parameters])[:-1]
            for target, part in zip(out, np.split(jacobian, ends, axis=1), strict=True):
                if target is not None:
                    target[:] = part.ravel()
        return residual

    return evaluate


class _OnIteration(pyceres.IterationCallback):  # type: ignore[misc]
    """Records each iteration; ends the solve at the limit."""

    def __init__(self, graph: _Graph, monitor: SolveMonitor) -> None:
        super().__init__()
        self._graph, self._monitor = graph, monitor

    def __call__(self, summary: Any) -> Any:
        x = np.concatenate(self._graph.values) if summary.step_is_successful else None
        self._monitor.record(summary.cost, x)
        types = pyceres.CallbackReturnType
        return types.SOLVER_ABORT if self._monitor.left() <= 0.0 else types.SOLVER_CONTINUE


class _CostFunction(pyceres.CostFunction):  # type: ignore[misc]
    """One block, as a function that Ceres calls."""

    def __init__(self, evaluate: Evaluate, rows: int, sizes: list[int]) -> None:
        super().__init__()
        self._evaluate = evaluate
        self.set_num_residuals(rows)
        self.set_parameter_block_sizes(sizes)

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """False where the model is undefined."""
        with np.errstate(all="ignore"):
            found = self._evaluate(parameters, jacobians)
            residuals[:] = found
            return bool(np.isfinite(found).all())
