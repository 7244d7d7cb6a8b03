"""Solvers of CasADi on polhode's own program: IPOPT with MUMPS, and an SQP method."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.solvers.casadi_nlp import program_functions
from polhode.backend.solvers.ipopt import MotionProgram, ProgramLayout
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array

MAX_ITERATIONS, MAX_SQP_ITERATIONS = 500, 200
_SILENT_QP = {"print_iter": False, "print_header": False}
QUADRATIC: dict[str, dict[str, Any]] = {
    "osqp": {"osqp": {"verbose": False, "eps_abs": 1e-7, "eps_rel": 1e-9, "max_iter": 4000, "polish": True}},
    "qrqp": _SILENT_QP,
    "ipqp": _SILENT_QP,
}
"""CasADi's solvers of quadratic programs, and their options."""


class Iterations(ca.Callback):
    """Records cost and point at each iteration of a CasADi solver; it must live as long as the solver.

    ``common`` takes the solver's unknowns to the common ones.
    """

    def __init__(
        self, n_x: int, n_p: int, monitor: SolveMonitor, common: Callable[[Array], Array] = lambda x: x
    ) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"x": n_x, "f": 1, "g": 0, "lam_x": n_x, "lam_g": 0, "lam_p": n_p}
        self._monitor, self._common = monitor, common
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
        self._monitor.record(float(arguments[1]), self._common(np.asarray(arguments[0]).ravel()))
        return [1 if self._monitor.left() <= 0.0 else 0]


@dataclass
class CasadiSolver:
    """``backend.solvers.ipopt.MotionProgram`` by IPOPT, or by the SQP method with a solver of QPs."""

    qp: str = ""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Solve with the tolerances of the back end, with its times read."""
        program = _MonitoredProgram(problem, monitor, self.qp)
        most = MAX_SQP_ITERATIONS if self.qp else MAX_ITERATIONS
        found = program.solve(problem.fixed, x, most, max(monitor.left(), 0.1))
        monitor.seconds["evaluation"] += evaluation_s(program.stats)
        monitor.check()
        return AdapterResult(found.x, found.converged, found.iterations, found.message)


class _MonitoredProgram(MotionProgram):
    def __init__(self, problem: MeasuredProblem, monitor: SolveMonitor, qp: str) -> None:
        super().__init__(problem.data)
        self.monitor, self.qp, self.n_x = monitor, qp, len(problem.cold)
        self.stats: dict[str, Any] = {}

    def build(self, layout: ProgramLayout, max_iterations: int, max_seconds: float) -> Any:
        """The solver, with its statistics kept."""
        with self.monitor.part("build"):
            self._iterations = Iterations(self.n_x, layout.n_p, self.monitor)
            problem, derivatives = program_functions(*self.expressions(layout))
            options = {**self.options(max_iterations, max_seconds), **derivatives}
            if self.qp:
                options = _sqp_options(self.qp, derivatives, max_iterations)
            # large steps from a cold start leave the domain and are rejected: no warning is needed
            options |= {"iteration_callback": self._iterations, "show_eval_warnings": False}
            solver: Any = ca.nlpsol("motion", "sqpmethod" if self.qp else "ipopt", problem, options)

        def call(**arguments: Any) -> Any:
            result = solver(**arguments)
            self.stats = solver.stats()
            return result

        call.stats = lambda: self.stats  # type: ignore[attr-defined]
        return call


def evaluation_s(stats: dict[str, Any]) -> float:
    """Time of evaluations [s] in the statistics of IPOPT, or of the SQP method, which has joint ones."""
    names = ("f", "grad_f", "hess_l", "g", "jac_g", "fg", "jac_fg")
    return float(sum(stats.get(f"t_wall_nlp_{name}", 0.0) for name in names))


def _sqp_options(qp: str, derivatives: dict[str, Any], max_iterations: int) -> dict[str, Any]:
    """Steps with a line search, to a small gradient or step."""
    gradient, upper = derivatives["grad_f"], derivatives["hess_lag"]
    x, p = (ca.MX.sym(name, gradient.sparsity_in(i)) for i, name in enumerate("xp"))
    none = [ca.MX(0, 1), ca.MX(0, x.numel())]
    names = ["f", "grad_f_x", "g", "jac_g_x"]
    joint = ca.Function("nlp_jac_fg", [x, p], [*gradient(x, p), *none], ["x", "p"], names)
    arguments = [ca.MX.sym(upper.name_in(i), upper.sparsity_in(i)) for i in range(upper.n_in())]
    whole = [ca.triu2symm(upper.call(arguments)[0])]
    silent = ("print_time", "print_header", "print_iteration", "print_status", "error_on_fail", "calc_lam_p")
    return {
        "jac_fg": joint,
        "hess_lag": ca.Function("nlp_hess_l", arguments, whole, upper.name_in(), ["hess_gamma_x_x"]),
        "qpsol": qp,
        "qpsol_options": {"error_on_fail": False, "print_time": False, **QUADRATIC[qp]},
        "max_iter": max_iterations,
        "max_iter_ls": 12,
        "tol_du": 1e-3,
        "min_step_size": 1e-12,
        "no_nlp_grad": True,
        **dict.fromkeys(silent, False),
    }
