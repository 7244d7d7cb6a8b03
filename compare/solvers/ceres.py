"""Ceres through pyceres: blocks of the common cost as cost functions.

pyceres calls a Python function for every block and has no hook before an evaluation. So the measurements of a
landmark are one block (``landmark_block``); what the calls cost is stated.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from polhode.compare.problem.blocks import Blocks
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.problem.single_blocks import SingleSteps, compile_block, landmark_block
from polhode.compare.solver import Outcome, SolveMonitor
from polhode.lie import Array

TOLERANCE = 1e-10
MAX_ITERATIONS = 500


class Ceres:
    """Levenberg-Marquardt, landmarks eliminated by Ceres's own Schur complement."""

    def __init__(self) -> None:
        """The compiled loop is loaded before any clock starts."""
        compile_block()

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """Levenberg-Marquardt to a relative decrease of TOLERANCE."""
        import pyceres

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
            callback = _on_iteration(graph, monitor)
            options.callbacks = [callback]
        summary = pyceres.SolverSummary()
        pyceres.solve(options, graph.problem, summary)
        # with what Ceres itself does around each call
        own = summary.residual_evaluation_time_in_seconds + summary.jacobian_evaluation_time_in_seconds
        monitor.seconds["evaluation"] = max(monitor.callback_s, own)
        converged = summary.termination_type == pyceres.TerminationType.CONVERGENCE
        end = graph.vector()
        iterations = len(monitor.trace) - 1
        if not converged and monitor.left() <= 0.0:
            monitor.check()
        spare = monitor.stop()
        cov = graph.covariance() if converged and spare else None
        return Outcome(end, converged, iterations, str(summary.message), cov)


class _Graph:
    """As Ceres knows it: a parameter block for each pose, rest of a state, constants, landmark."""

    def __init__(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> None:
        import pyceres

        self.problem = pyceres.Problem()
        self.blocks, self.monitor = Blocks(problem.data, problem.held), monitor
        self.parts = self._parts()
        # Ceres holds the addresses of these and writes to them: never to x
        self.values = [x[part].copy() for part in self.parts]
        self._costs: list[Any] = []
        self._add_landmarks(problem)
        self._add_steps()
        self._add_others(x)

    def _add(self, evaluate: "Evaluate", rows: int, owners: list[int]) -> None:
        cost = _cost_function(evaluate, rows, [len(self.values[owner]) for owner in owners], self.monitor)
        self._costs.append(cost)
        self.problem.add_residual_block(cost, None, [self.values[owner] for owner in owners])

    def _add_landmarks(self, problem: MeasuredProblem) -> None:
        d, held = problem.data, problem.held
        first = 2 * d.n_frames + 1
        for mark in range(d.n_landmarks):
            at = slice(d.start[mark], d.start[mark + 1])
            frames = d.frame[at]
            fixed = (held.A[frames], d.R_RN[frames], d.t_R[frames], d.uvd_px[at], d.inv_sigma[at], d.rig)
            evaluate = _of_landmark(fixed, d.robust_scale)
            self._add(evaluate, 3 * len(frames), [first + mark, *(2 * frames).tolist()])

    def _add_steps(self) -> None:
        steps = SingleSteps(self.blocks)
        constants = 2 * self.blocks.data.n_frames
        for k in range(self.blocks.data.n_frames - 1):
            owners = [2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 3, constants]
            self._add(_of_step(steps, k), 12, owners)

    def _add_others(self, x: Array) -> None:
        """They are linear or small: evaluated with the others frozen where they do not matter."""
        owner = np.empty(len(x), dtype=np.int64)
        for number, part in enumerate(self.parts):
            owner[part] = number
        for kind, block in enumerate(self.blocks.others(x)):
            for row in range(len(block.residual)):
                owners = list(dict.fromkeys(owner[block.slots[row]].tolist()))
                evaluate = _of_other(self.blocks, kind, row, x.copy(), [self.parts[o] for o in owners])
                self._add(evaluate, block.residual.shape[1], owners)

    def _parts(self) -> list[slice]:
        b, parts = self.blocks, []
        for k in range(b.data.n_frames):
            parts += [slice(b.n_state * k, b.n_state * k + 6), slice(b.n_state * k + 6, b.n_state * (k + 1))]
        parts.append(slice(b.n_states, b.n_dense))
        return parts + [slice(at, at + 3) for at in range(b.n_dense, b.n_x, 3)]

    def vector(self) -> Array:
        """The unknowns as they stand (n,)."""
        return np.concatenate(self.values)

    def covariance(self) -> Array | None:
        """(8, 8) of com_G, xi by Ceres."""
        import pyceres

        constants = self.values[2 * self.blocks.data.n_frames]
        options = pyceres.CovarianceOptions()
        options.num_threads = 1
        found = pyceres.Covariance(options)
        if not found.compute([(constants, constants)], self.problem):
            return None
        return np.asarray(found.get_covariance_block(constants, constants))[:8, :8]


Fixed = tuple[Array, Array, Array, Array, Array, Array]
"""Of a landmark's measurements: A_ref, R_RN, t_R, uvd, 1 / sigma, rig."""
Evaluate = Callable[[list[Array], list[Array | None] | None], Array]
"""Parameters, where to write the Jacobians: residuals."""


def _of_landmark(fixed: Fixed, scale: float) -> Evaluate:
    n = len(fixed[0])
    of_poses, of_mark = np.empty((n, 3, 6)), np.empty((n, 3, 3))

    def evaluate(parameters: list[Array], out: list[Array | None] | None) -> Array:
        poses = np.array(parameters[1:])
        residual = landmark_block(poses, np.array(parameters[0]), *fixed, scale, of_poses, of_mark)
        if out is not None:
            if out[0] is not None:
                out[0][:] = of_mark.ravel()
            for m in range(n):
                place = out[1 + m]
                if place is not None:
                    # rows of the other frames do not depend on this pose
                    place[:] = 0.0
                    place[18 * m : 18 * m + 18] = of_poses[m].ravel()
        return residual.ravel()

    return evaluate


def _of_step(steps: SingleSteps, k: int) -> Evaluate:
    def evaluate(parameters: list[Array], out: list[Array | None] | None) -> Array:
        x = np.concatenate(parameters)
        if out is None:
            return steps.residual(k, x)
        residual, jacobian = steps.jacobian(k, x)
        _write(out, jacobian, [len(each) for each in parameters])
        return residual

    return evaluate


def _of_other(blocks: Blocks, kind: int, row: int, x: Array, parts: list[slice]) -> Evaluate:
    def evaluate(parameters: list[Array], out: list[Array | None] | None) -> Array:
        for part, values in zip(parts, parameters, strict=True):
            x[part] = values
        block = blocks.others(x)[kind]
        if out is not None:
            wide = np.zeros((block.jacobian.shape[1], len(x)))
            wide[:, block.slots[row]] = block.jacobian[row]
            jacobian = np.hstack([wide[:, part] for part in parts])
            _write(out, jacobian, [part.stop - part.start for part in parts])
        return np.asarray(block.residual[row])

    return evaluate


def _write(out: list[Array | None], jacobian: Array, sizes: list[int]) -> None:
    start = 0
    for place, size in zip(out, sizes, strict=True):
        if place is not None:
            place[:] = jacobian[:, start : start + size].ravel()
        start += size


def _on_iteration(graph: _Graph, monitor: SolveMonitor) -> Any:
    import pyceres

    class OnIteration(pyceres.IterationCallback):  # type: ignore[misc]
        """Notes the cost; ends the solve at the limit."""

        def __call__(self, summary: Any) -> Any:
            monitor.note(summary.cost, graph.vector() if summary.step_is_successful else None)
            stop = pyceres.CallbackReturnType.SOLVER_ABORT
            return stop if monitor.left() <= 0.0 else pyceres.CallbackReturnType.SOLVER_CONTINUE

    return OnIteration()


def _cost_function(evaluate: Evaluate, rows: int, sizes: list[int], monitor: SolveMonitor) -> Any:
    import pyceres

    class OneBlock(pyceres.CostFunction):  # type: ignore[misc]
        """What Ceres calls."""

        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(rows)
            self.set_parameter_block_sizes(sizes)

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            """False where the model has no value."""
            with monitor.callback(), np.errstate(all="ignore"):
                found = evaluate(parameters, jacobians)
                residuals[:] = found
                return bool(np.isfinite(found).all())

    return OneBlock()
