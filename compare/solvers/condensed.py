"""IPOPT on states and constants alone: the landmarks are condensed, exactly, at every point.

The reduced cost is the least over the landmarks (variable projection); its gradient and Gauss-Newton Hessian
follow from the Schur complement there.
"""

from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.solvers.casadi_nlp import OPTIMAL, ExternalFunction
from polhode.backend.solvers.gauss_newton import GaussNewton, NormalEquations
from polhode.backend.solvers.ipopt import MESSAGES, MotionProgram
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import Outcome, SolveMonitor
from polhode.compare.solvers.ipopt import MAX_ITERATIONS, Iterations
from polhode.lie import Array

INNER = 30
"""Most Newton steps of the landmarks at a point."""
INNER_TOLERANCE = 1e-12
"""Of the decrease that they promise, over the cost."""


class ReducedCost:
    """Cost, gradient and Hessian of states and constants (n,), landmarks at their optimum."""

    def __init__(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> None:
        self.problem, self.monitor = problem, monitor
        self._newton = GaussNewton(problem.data)
        self.n = problem.held.reference.n_dense
        self.marks = x[self.n :].copy()
        self._y: Array | None = None
        self._system: NormalEquations | None = None
        self._reduced: tuple[Array, Array] | None = None

    def cost(self, y: Array) -> float:
        """The common cost, least over the landmarks."""
        return self._at(y).cost

    def whole(self, y: Array) -> Array:
        """With the landmarks: the common unknowns."""
        self._at(y)
        return np.concatenate([y, self.marks])

    def gradient(self, y: Array) -> Array:
        """(n,)"""
        return self._schur(y)[1]

    def hessian(self, y: Array) -> Array:
        """Upper triangle by columns: the lower one by rows."""
        return self._schur(y)[0][np.tril_indices(self.n)]

    def _schur(self, y: Array) -> tuple[Array, Array]:
        system = self._at(y)
        if self._reduced is None:
            with self.monitor.callback(None):
                S, g, _ = self._newton.reduced(system)
                self._reduced = S, g
        return self._reduced

    def _at(self, y: Array) -> NormalEquations:
        if self._y is None or self._system is None or not np.array_equal(y, self._y):
            with self.monitor.callback(), np.errstate(all="ignore"):
                self._system, self._y, self._reduced = self._settled(y), y.copy(), None
        return self._system

    def _settled(self, y: Array) -> NormalEquations:
        """Newton steps of each landmark, halved where they do not help, until they promise nothing more."""
        d, held, marks = self.problem.data, self.problem.held, self.marks
        system = self._newton.normal_equations(held, np.concatenate([y, marks]))
        before = self._of_marks(y, marks)
        for _ in range(INNER):
            step = -np.linalg.solve(system.C + 1e-12 * np.eye(3), system.h[:, :, None])[:, :, 0]
            promised = -0.5 * float(np.sum(step * system.h))
            if not promised > INNER_TOLERANCE * max(system.cost, 1.0):
                break
            length = np.ones(d.n_landmarks)
            for _ in range(8):
                there = (marks.reshape(-1, 3) + length[:, None] * step).ravel()
                after = self._of_marks(y, there)
                worse = ~(after <= before)
                if not worse.any():
                    break
                length[worse] *= 0.25
            length[~(after <= before)] = 0.0
            marks = (marks.reshape(-1, 3) + length[:, None] * step).ravel()
            before = self._of_marks(y, marks)
            system = self._newton.normal_equations(held, np.concatenate([y, marks]))
        if np.isfinite(system.cost):
            self.marks = marks
        return system

    def _of_marks(self, y: Array, marks: Array) -> Array:
        """Robust cost of each landmark's measurements (L,)."""
        d = self.problem.data
        residuals, _ = self._newton.residuals(self.problem.held, np.concatenate([y, marks]))
        c = d.robust_scale
        each = 0.5 * c**2 * np.log1p(np.sum(residuals**2, axis=1) / c**2)
        return np.asarray(np.bincount(d.landmark, each, d.n_landmarks), dtype=np.float64)


class Condensed:
    """IPOPT over the reduced cost."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> Outcome:
        """With the tolerances of the back end's program."""
        with monitor.part("build"):
            reduced = ReducedCost(problem, x, monitor)
            n = reduced.n
            y = ca.MX.sym("y", n)
            kinds = ((reduced.cost, 1), (reduced.gradient, n), (reduced.hessian, n * (n + 1) // 2))
            outside = [ExternalFunction(f.__name__, f, (n,), size) for f, size in kinds]
            cost, gradient, second = (function(y) for function in outside)
            p, lam_f, lam_g = ca.MX.sym("p", 0), ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0)
            base = MotionProgram(problem.data)
            options = base.options(MAX_ITERATIONS, max(monitor.left(), 0.1))
            options["grad_f"] = ca.Function(
                "nlp_grad_f", [y, p], [cost, gradient], ["x", "p"], ["f", "grad_f_x"]
            )
            options["hess_lag"] = ca.Function(
                "nlp_hess_l",
                [y, p, lam_f, lam_g],
                [ca.MX(ca.Sparsity.upper(n), lam_f * second)],
                ["x", "p", "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            )
            listener = Iterations(n, 0, 0, monitor, reduced.whole)
            options["iteration_callback"] = listener
            solver: Any = ca.nlpsol("condensed", "ipopt", {"x": y, "p": p, "f": cost}, options)
        result = solver(x0=x[:n])
        stats = solver.stats()
        status = str(stats["return_status"])
        found = reduced.whole(np.asarray(result["x"]).ravel())
        monitor.check()
        return Outcome(found, status in OPTIMAL, int(stats["iter_count"]), MESSAGES.get(status, status))
