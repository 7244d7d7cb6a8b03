"""Ceres through pyceres: blocks of the common cost as cost functions.

pyceres calls a Python function for every block, so that all measurements of a landmark are one block
(``landmark_block``). The time of the calls is in the rows.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pyceres

from polhode.compare.problem.blocks import Blocks, Evaluation, SingleBlocks, compile_block, landmark_block
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array

TOLERANCE = 1e-10
MAX_ITERATIONS = 500


class Ceres:
    """Levenberg-Marquardt, landmarks eliminated by Ceres's own Schur complement."""

    def __init__(self) -> None:
        """Load the compiled loop before the clock starts."""
        compile_block()

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Levenberg-Marquardt to a relative decrease of TOLERANCE."""
        with monitor.part("build"):
            graph = _Graph(problem, x, monitor)
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
        # with Ceres's own work around each call
        own = summary.residual_evaluation_time_in_seconds + summary.jacobian_evaluation_time_in_seconds
        monitor.seconds["evaluation"] = max(monitor.callback_s, own)
        converged = summary.termination_type == pyceres.TerminationType.CONVERGENCE
        end = graph.vector()
        iterations = len(monitor.trace) - 1
        if not converged and monitor.left() <= 0.0:
            monitor.check()
        spare = monitor.stop()
        cov = graph.covariance() if converged and spare else None
        return AdapterResult(end, converged, iterations, str(summary.message), cov)


class _Graph:
    """Ceres's problem: parameter blocks are poses, other components of states, constants, landmarks."""

    def __init__(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> None:
        self.problem = pyceres.Problem()
        self.blocks, self.monitor = Blocks(problem.data, problem.fixed), monitor
        self.single = SingleBlocks(self.blocks)
        self.parts = self._parts()
        # Ceres keeps their addresses and writes to them, so they are copies of x
        self.values = [x[part].copy() for part in self.parts]
        self._costs: list[Any] = []
        self._add_landmarks(problem)
        self._add_steps()
        self._add_others(x)

    def _add(self, evaluate: "Evaluate", rows: int, owners: list[int]) -> None:
        cost = _CostFunction(evaluate, rows, [len(self.values[owner]) for owner in owners], self.monitor)
        self._costs.append(cost)
        self.problem.add_residual_block(cost, None, [self.values[owner] for owner in owners])

    def _add_landmarks(self, problem: MeasuredProblem) -> None:
        d, fixed = problem.data, problem.fixed
        first = 2 * d.n_frames + 1
        for landmark in range(d.n_landmarks):
            at = slice(d.start[landmark], d.start[landmark + 1])
            frames = d.frame[at]
            data = (fixed.A[frames], d.R_RN[frames], d.t_R[frames], d.uvd_px[at], d.inv_sigma[at], d.rig)
            evaluate = _of_landmark(data, d.robust_scale)
            self._add(evaluate, 3 * len(frames), [first + landmark, *(2 * frames).tolist()])

    def _add_steps(self) -> None:
        constants = 2 * self.blocks.data.n_frames
        for k in range(self.blocks.data.n_frames - 1):
            owners = [2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 3, constants]
            self._add(_of_block(self.single.step(k)), 12, owners)

    def _add_others(self, x: Array) -> None:
        """Priors: linear or small, evaluated with the unknowns of other blocks at the start."""
        owner = np.empty(len(x), dtype=np.int64)
        for number, part in enumerate(self.parts):
            owner[part] = number
        for kind, block in enumerate(self.blocks.others(x)):
            for row in range(len(block.residual)):
                owners = list(dict.fromkeys(owner[block.slots[row]].tolist()))
                slots = np.concatenate([np.r_[self.parts[owner]] for owner in owners])
                evaluate = _of_block(self.single.prior(kind, row, x, slots))
                self._add(evaluate, block.residual.shape[1], owners)

    def _parts(self) -> list[slice]:
        b, parts = self.blocks, []
        for k in range(b.data.n_frames):
            parts += [slice(b.n_state * k, b.n_state * k + 6), slice(b.n_state * k + 6, b.n_state * (k + 1))]
        parts.append(slice(b.n_states, b.n_dense))
        return parts + [slice(at, at + 3) for at in range(b.n_dense, b.n_x, 3)]

    def vector(self) -> Array:
        """The current unknowns (n,)."""
        return np.concatenate(self.values)

    def covariance(self) -> Array | None:
        """(8, 8) of com_G, xi by Ceres."""
        constants = self.values[2 * self.blocks.data.n_frames]
        options = pyceres.CovarianceOptions()
        options.num_threads = 1
        found = pyceres.Covariance(options)
        if not found.compute([(constants, constants)], self.problem):
            return None
        return np.asarray(found.get_covariance_block(constants, constants))[:8, :8]


Evaluate = Callable[[list[Array], list[Array | None] | None], Array]
"""(Parameters, arrays to fill with the Jacobians) -> residuals."""


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
        self._monitor.record(summary.cost, self._graph.vector() if summary.step_is_successful else None)
        stop = self._monitor.left() <= 0.0
        types = pyceres.CallbackReturnType
        return types.SOLVER_ABORT if stop else types.SOLVER_CONTINUE


class _CostFunction(pyceres.CostFunction):  # type: ignore[misc]
    """One block, as a function that Ceres calls."""

    def __init__(self, evaluate: Evaluate, rows: int, sizes: list[int], monitor: SolveMonitor) -> None:
        super().__init__()
        self._evaluate, self._monitor = evaluate, monitor
        self.set_num_residuals(rows)
        self.set_parameter_block_sizes(sizes)

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """False where the model is undefined."""
        with self._monitor.callback(), np.errstate(all="ignore"):
            found = self._evaluate(parameters, jacobians)
            residuals[:] = found
            return bool(np.isfinite(found).all())
