"""Solvers of CasADi: IPOPT with MUMPS on polhode's own program and other formulations, and an SQP method."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.solvers.casadi_nlp import OPTIMAL
from polhode.backend.solvers.ipopt import MESSAGES, MotionProgram, ProgramLayout
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.compare.solvers.casadi_program import Formulation, VariantProgram
from polhode.geometry.lie import Array

MAX_ITERATIONS, MAX_SQP_ITERATIONS = 500, 200
TIMES = (
    "t_wall_nlp_f", "t_wall_nlp_grad_f", "t_wall_nlp_hess_l", "t_wall_nlp_g", "t_wall_nlp_jac_g",
    "t_wall_nlp_fg", "t_wall_nlp_jac_fg",
)  # fmt: skip
"""Evaluations in CasADi's statistics: IPOPT's, and the joint functions of its SQP method."""
_SILENT_QP = {"print_iter": False, "print_header": False}
QUADRATIC: dict[str, tuple[str, dict[str, Any]]] = {
    "osqp": (
        "osqp",
        {"osqp": {"verbose": False, "eps_abs": 1e-7, "eps_rel": 1e-9, "max_iter": 4000, "polish": True}},
    ),
    "qrqp": ("qrqp", _SILENT_QP),
    "ipqp": ("ipqp", _SILENT_QP),
}
"""CasADi's solver of the quadratic programs, and its options."""


class Iterations(ca.Callback):
    """Records cost and point at each iteration of a CasADi solver; it must live as long as the solver.

    ``common`` takes the solver's unknowns to the common ones.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        monitor: SolveMonitor,
        common: Callable[[Array], Array] = lambda x: x,
    ) -> None:
        """``sizes``: numbers of unknowns, constraints and parameters."""
        ca.Callback.__init__(self)
        n_x, n_g, n_p = sizes
        self._sizes = {"x": n_x, "f": 1, "g": n_g, "lam_x": n_x, "lam_g": n_g, "lam_p": n_p}
        self._monitor, self._common, self._unconstrained = monitor, common, n_g == 0
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
        x = self._common(np.asarray(arguments[0]).ravel())
        # with constraints the objective is the cost only once they are satisfied
        self._monitor.record(float(arguments[1]), x, common=self._unconstrained)
        return [1 if self._monitor.left() <= 0.0 else 0]


class Shipped:
    """``backend.solvers.ipopt.MotionProgram``: weighted, Gauss-Newton Hessian, stereo in compiled loops."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Solve as the back end does, with its times read."""
        program = _MonitoredProgram(problem, monitor)
        found = program.solve(problem.fixed, x, MAX_ITERATIONS, max(monitor.left(), 0.1))
        monitor.seconds["evaluation"] += evaluation_s(program.stats)
        monitor.check()
        return AdapterResult(found.x, found.converged, found.iterations, found.message)


class _MonitoredProgram(MotionProgram):
    def __init__(self, problem: MeasuredProblem, monitor: SolveMonitor) -> None:
        super().__init__(problem.data)
        self.monitor, self.n_x = monitor, len(problem.cold)
        self.stats: dict[str, Any] = {}

    def options(self, max_iterations: int, max_seconds: float) -> dict[str, Any]:
        """Those of the back end, with the callback."""
        self._iterations = Iterations((self.n_x, 0, self.n_p), self.monitor)
        return {**super().options(max_iterations, max_seconds), "iteration_callback": self._iterations}

    def build(self, layout: ProgramLayout, max_iterations: int, max_seconds: float) -> Any:
        """The solver of the back end, with its statistics kept."""
        self.n_p = layout.n_p
        with self.monitor.part("build"):
            solver = super().build(layout, max_iterations, max_seconds)

        def call(**arguments: Any) -> Any:
            result = solver(**arguments)
            self.stats = solver.stats()
            return result

        call.stats = lambda: self.stats  # type: ignore[attr-defined]
        return call


class Variant(Formulation):
    """IPOPT on one formulation of the program."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Build, solve with the tolerances of the back end's program."""
        return _solve("ipopt", problem, self, x, monitor, _ipopt_options)


def _ipopt_options(program: VariantProgram, derivatives: dict[str, Any], limit_s: float) -> dict[str, Any]:
    options = program.options(MAX_ITERATIONS, limit_s)
    limits = {"theta_max_fact": 1e12, "acceptable_constr_viol_tol": 1e-6}
    return {**options, **derivatives, "ipopt": {**options["ipopt"], **limits}}


@dataclass
class Sqp:
    """CasADi's SQP method with one of its solvers of quadratic programs; weighted, Gauss-Newton Hessian."""

    qp: str = "osqp"

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Steps with a line search, to a small gradient or step."""
        return _solve("sqpmethod", problem, Formulation(), x, monitor, self._options)

    def _options(self, _: VariantProgram, derivatives: dict[str, Any], __: float) -> dict[str, Any]:
        name, options = QUADRATIC[self.qp]
        return {
            "jac_fg": _with_no_constraints(derivatives["grad_f"]),
            "hess_lag": _both_triangles(derivatives["hess_lag"]),
            "qpsol": name,
            "qpsol_options": {"error_on_fail": False, "print_time": False, **options},
            "print_time": False,
            "print_header": False,
            "print_iteration": False,
            "print_status": False,
            "error_on_fail": False,
            "max_iter": MAX_SQP_ITERATIONS,
            "max_iter_ls": 12,
            "tol_du": 1e-3,
            "min_step_size": 1e-12,
            "calc_lam_p": False,
            "no_nlp_grad": True,
        }


def _solve(
    plugin: str,
    problem: MeasuredProblem,
    formulation: Formulation,
    x: Array,
    monitor: SolveMonitor,
    options_of: Callable[[VariantProgram, dict[str, Any], float], dict[str, Any]],
) -> AdapterResult:
    """Build a formulation's program and solve it from x (n,) with a plugin of CasADi."""
    with TemporaryDirectory(prefix="polhode-compare-") as folder:
        with monitor.part("build"):
            program = VariantProgram(problem, formulation, Path(folder))
            functions, derivatives = program.functions()
            sizes = (program.n_x + program.n_slack, program.n_slack, len(program.p))
            iterations = Iterations(sizes, monitor, lambda z: z[: program.n_x])
            options = options_of(program, derivatives, max(monitor.left(), 0.1))
            # large steps from a cold start leave the domain and are rejected: no warning is needed
            options |= {"iteration_callback": iterations, "show_eval_warnings": False}
            solver: Any = ca.nlpsol("variant", plugin, functions, options)
        result = solver(x0=program.start(x), p=program.p, lbg=0.0, ubg=0.0)
        stats = solver.stats()
    monitor.seconds["evaluation"] += evaluation_s(stats)
    monitor.check()
    status = str(stats["return_status"])
    end = np.asarray(result["x"]).ravel()[: program.n_x]
    converged = status in OPTIMAL if plugin == "ipopt" else bool(stats["success"])
    return AdapterResult(end, converged, int(stats["iter_count"]), MESSAGES.get(status, status))


def evaluation_s(stats: dict[str, Any]) -> float:
    """Time of evaluations in the statistics of a CasADi solver [s]."""
    return float(sum(stats.get(name, 0.0) for name in TIMES))


def _with_no_constraints(gradient: Any) -> Any:
    """(x, p) -> cost, gradient, and empty constraints with their Jacobian."""
    x, p = (ca.MX.sym(name, gradient.sparsity_in(i)) for i, name in enumerate("xp"))
    cost, slope = gradient(x, p)
    none, jacobian = ca.MX(0, 1), ca.MX(0, x.numel())
    outputs = ["f", "grad_f_x", "g", "jac_g_x"]
    return ca.Function("nlp_jac_fg", [x, p], [cost, slope, none, jacobian], ["x", "p"], outputs)


def _both_triangles(upper: Any) -> Any:
    """The whole Hessian of the Lagrangian, as the SQP method needs it."""
    arguments = [ca.MX.sym(upper.name_in(i), upper.sparsity_in(i)) for i in range(upper.n_in())]
    whole = ca.triu2symm(upper.call(arguments)[0])
    return ca.Function("nlp_hess_l", arguments, [whole], upper.name_in(), ["hess_gamma_x_x"])
