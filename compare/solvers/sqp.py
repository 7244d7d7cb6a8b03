"""CasADi's SQP method over the common cost, with one of CasADi's solvers of quadratic programs."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np

from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import Outcome, SolveMonitor
from polhode.compare.solvers.casadi_program import Formulation, VariantProgram
from polhode.compare.solvers.ipopt import Iterations, evaluation_s
from polhode.lie import Array

MAX_ITERATIONS = 200
QUADRATIC: dict[str, dict[str, Any]] = {
    "osqp": {"osqp": {"verbose": False, "eps_abs": 1e-7, "eps_rel": 1e-9, "max_iter": 4000, "polish": True}},
    "proxqp": {"proxqp": {"eps_abs": 1e-7, "verbose": False}},
    "highs": {"highs": {"output_flag": False}},
    "qrqp": {"print_iter": False, "print_header": False},
    "ipqp": {"print_iter": False, "print_header": False},
    "ipopt": {},
}
"""Options of each solver."""


@dataclass
class Sqp:
    """Gauss-Newton Hessian, weighted residuals."""

    qp: str = "osqp"

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """Steps with a line search; ends at a small gradient or step."""
        with TemporaryDirectory(prefix="polhode-compare-") as folder:
            with monitor.part("build"):
                program = VariantProgram(problem, Formulation(), Path(folder))
                functions, given = program.functions()
                listener = Iterations(program.n_x, 0, len(program.p), monitor)
                name, inner = self.qp, {"error_on_fail": False, "print_time": False, **QUADRATIC[self.qp]}
                if self.qp == "ipopt":
                    name = "nlpsol"
                    inner = {
                        "error_on_fail": False,
                        "nlpsol": "ipopt",
                        "nlpsol_options": {
                            "print_time": False,
                            "ipopt": {"print_level": 0, "sb": "yes", "hessian_constant": "yes",
                                      "nlp_scaling_method": "none", "tol": 1e-6},
                        },
                    }  # fmt: skip
                options: dict[str, Any] = {
                    "jac_fg": _with_no_constraints(given["grad_f"]),
                    "hess_lag": _both_triangles(given["hess_lag"]),
                    "qpsol": name,
                    "qpsol_options": inner,
                    "print_time": False,
                    "print_header": False,
                    "print_iteration": False,
                    "print_status": False,
                    "error_on_fail": False,
                    "max_iter": MAX_ITERATIONS,
                    "max_iter_ls": 12,
                    "tol_du": 1e-3,
                    "min_step_size": 1e-12,
                    "calc_lam_p": False,
                    "no_nlp_grad": True,
                    "iteration_callback": listener,
                    "show_eval_warnings": False,
                }
                solver: Any = ca.nlpsol("sqp", "sqpmethod", functions, options)
            result = solver(x0=x, p=program.p)
            stats = solver.stats()
        monitor.seconds["evaluation"] += evaluation_s(stats)
        monitor.check()
        end = np.asarray(result["x"]).ravel()
        return Outcome(end, bool(stats["success"]), int(stats["iter_count"]), str(stats["return_status"]))


def _with_no_constraints(gradient: Any) -> Any:
    """(x, p) -> cost, gradient, constraints and their Jacobian: none."""
    x, p = (ca.MX.sym(name, gradient.sparsity_in(i)) for i, name in enumerate("xp"))
    cost, slope = gradient(x, p)
    none, jacobian = ca.MX(0, 1), ca.MX(0, x.numel())
    outputs = ["f", "grad_f_x", "g", "jac_g_x"]
    return ca.Function("nlp_jac_fg", [x, p], [cost, slope, none, jacobian], ["x", "p"], outputs)


def _both_triangles(upper: Any) -> Any:
    """The Hessian of the Lagrangian as this method wants it."""
    arguments = [ca.MX.sym(upper.name_in(i), upper.sparsity_in(i)) for i in range(upper.n_in())]
    whole = ca.triu2symm(upper.call(arguments)[0])
    return ca.Function("nlp_hess_l", arguments, [whole], upper.name_in(), ["hess_gamma_x_x"])
