"""IPOPT with MUMPS on polhode's own program."""

from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.solvers.ipopt import MotionProgram, ProgramLayout
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array

MAX_ITERATIONS = 500


class Iterations(ca.Callback):
    """Records cost and point at each iteration of IPOPT; it must live as long as the solver."""

    def __init__(self, n_x: int, n_p: int, monitor: SolveMonitor) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"x": n_x, "f": 1, "g": 0, "lam_x": n_x, "lam_g": 0, "lam_p": n_p}
        self._monitor = monitor
        self.construct("iterations", {})

    def get_n_in(self) -> int:
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, index: int) -> str:
        return str(ca.nlpsol_out(index))

    def get_sparsity_in(self, index: int) -> Any:
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(index)], 1)

    def eval(self, arguments: Any) -> list[int]:
        """0 to continue, 1 to stop."""
        self._monitor.record(float(arguments[1]), np.asarray(arguments[0]).ravel())
        return [1 if self._monitor.left() <= 0.0 else 0]


class Ipopt:
    """``backend.solvers.ipopt.MotionProgram``."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Solve with the tolerances of the back end."""
        program = _MonitoredProgram(problem, monitor)
        found = program.solve(problem.fixed, x, MAX_ITERATIONS, max(monitor.left(), 0.1))
        monitor.check()
        return AdapterResult(found.x, found.converged, found.iterations, found.message)


class _MonitoredProgram(MotionProgram):
    def __init__(self, problem: MeasuredProblem, monitor: SolveMonitor) -> None:
        super().__init__(problem.data)
        self.monitor, self.n_x = monitor, len(problem.cold)

    def build(self, layout: ProgramLayout, options: dict[str, Any]) -> Any:
        self._iterations = Iterations(self.n_x, layout.n_p, self.monitor)
        return super().build(layout, {**options, "iteration_callback": self._iterations})
