"""IPOPT with MUMPS: polhode's own program, and the same cost in other formulations."""

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
from polhode.compare.solver import Outcome, SolveMonitor
from polhode.compare.solvers.casadi_program import Code, Dynamics, Formulation, Hessian, VariantProgram
from polhode.lie import Array

MAX_ITERATIONS = 500
TIMES = (
    "t_wall_nlp_f", "t_wall_nlp_grad_f", "t_wall_nlp_hess_l", "t_wall_nlp_g", "t_wall_nlp_jac_g",
    "t_wall_nlp_fg", "t_wall_nlp_jac_fg",
)  # fmt: skip
"""Evaluations in CasADi's statistics: IPOPT's, and the joint functions of its SQP method."""
Common = Callable[[Array], Array]


class Iterations(ca.Callback):
    """Notes cost and point at each iteration of a CasADi solver; it must live as long as the solver.

    ``common`` takes the solver's unknowns to the common ones.
    """

    def __init__(
        self, n_x: int, n_g: int, n_p: int, monitor: SolveMonitor, common: Common = lambda x: x
    ) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"x": n_x, "f": 1, "g": n_g, "lam_x": n_x, "lam_g": n_g, "lam_p": n_p}
        self._watch, self._common, self.feasible = monitor, common, n_g == 0
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
        """Zero: go on."""
        x = self._common(np.asarray(arguments[0]).ravel())
        # with constraints the objective is not the cost until they hold
        self._watch.note(float(arguments[1]), x, common=self.feasible)
        return [1 if self._watch.left() <= 0.0 else 0]


class Shipped:
    """``backend.solvers.ipopt.MotionProgram``: weighted, Gauss-Newton Hessian, stereo in compiled loops."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """The back end's own call, its clock read."""
        program = _MonitoredProgram(problem, monitor)
        found = program.solve(problem.held, x, MAX_ITERATIONS, max(monitor.left(), 0.1))
        monitor.seconds["evaluation"] += evaluation_s(program.stats)
        monitor.check()
        return Outcome(found.x, found.converged, found.iterations, found.message)


class _MonitoredProgram(MotionProgram):
    def __init__(self, problem: MeasuredProblem, monitor: SolveMonitor) -> None:
        super().__init__(problem.data)
        self.monitor, self.n_x = monitor, len(problem.cold)
        self.stats: dict[str, Any] = {}

    def options(self, max_iterations: int, max_seconds: float) -> dict[str, Any]:
        """Those of the back end, with a listener."""
        self._listener = Iterations(self.n_x, 0, self.n_p, self.monitor)
        return {
            **super().options(max_iterations, max_seconds),
            "iteration_callback": self._listener,
        }

    def build(self, layout: ProgramLayout, max_iterations: int, max_seconds: float) -> Any:
        """TimedGaussNewton."""
        self.n_p = layout.n_p
        with self.monitor.part("build"):
            solver = super().build(layout, max_iterations, max_seconds)

        def call(**arguments: Any) -> Any:
            result = solver(**arguments)
            self.stats = solver.stats()
            return result

        call.stats = lambda: self.stats  # type: ignore[attr-defined]
        return call


@dataclass
class Variant:
    """One formulation of the program (``casadi_program.Formulation``)."""

    hessian: Hessian = "gauss_newton"
    dynamics: Dynamics = "weighted"
    code: Code = "vm"

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """Build, solve with the tolerances of the back end's program."""
        with TemporaryDirectory(prefix="polhode-compare-") as folder:
            with monitor.part("build"):
                formulation = Formulation(self.hessian, self.dynamics, self.code)
                program = VariantProgram(problem, formulation, Path(folder))
                functions, given = program.functions()
                options = {**program.options(MAX_ITERATIONS, max(monitor.left(), 0.1)), **given}
                sizes = (program.n_x + program.n_slack, program.n_slack, len(program.p))
                listener = Iterations(*sizes, monitor, lambda z: z[: program.n_x])
                options["iteration_callback"] = listener
                # wild steps of a cold start leave the domain: they are refused, and need not be told
                options["show_eval_warnings"] = False
                options["ipopt"] = {
                    **options["ipopt"],
                    "theta_max_fact": 1e12,
                    "acceptable_constr_viol_tol": 1e-6,
                }
                solver: Any = ca.nlpsol("variant", "ipopt", functions, options)
            result = solver(x0=program.start(x), p=program.p, lbg=0.0, ubg=0.0)
            stats = solver.stats()
        monitor.seconds["evaluation"] += evaluation_s(stats)
        monitor.check()
        status = str(stats["return_status"])
        x = np.asarray(result["x"]).ravel()[: program.n_x]
        return Outcome(x, status in OPTIMAL, int(stats["iter_count"]), MESSAGES.get(status, status))


def evaluation_s(stats: dict[str, Any]) -> float:
    return float(sum(stats.get(name, 0.0) for name in TIMES))
