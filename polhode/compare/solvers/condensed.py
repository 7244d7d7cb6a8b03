"""IPOPT on states and constants alone: at every point the landmarks are eliminated, exactly.

The reduced cost is the minimum over the landmarks (variable projection); its gradient and Gauss-Newton
Hessian follow from the Schur complement there.
"""

import casadi as ca
import numpy as np

from polhode.backend.solvers.casadi_nlp import OPTIMAL, ExternalFunction, ipopt_solver
from polhode.backend.solvers.gauss_newton import GaussNewton, NormalEquations
from polhode.backend.solvers.ipopt import MESSAGES, MotionProgram
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.compare.solvers.casadi_solvers import MAX_ITERATIONS, Iterations
from polhode.geometry.lie import Array

INNER = 30
"""Largest number of Newton steps of the landmarks at a point."""
INNER_TOLERANCE = 1e-12
"""Predicted decrease over the cost at which they end."""


class ReducedCost:
    """Cost, gradient and Hessian of states and constants (n,), landmarks at their optimum."""

    def __init__(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> None:
        self.problem, self.monitor = problem, monitor
        self._newton = GaussNewton(problem.data)
        self.n = problem.fixed.reference.n_dense
        self.landmarks = x[self.n :].copy()
        self._y: Array | None = None
        self._system: NormalEquations | None = None
        self._reduced: tuple[Array, Array] | None = None

    def cost(self, y: Array) -> float:
        """The common cost, minimized over the landmarks."""
        return self._at(y).cost

    def whole(self, y: Array) -> Array:
        """The common unknowns: states, constants and the landmarks at their optimum."""
        self._at(y)
        return np.concatenate([y, self.landmarks])

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
                self._system, self._y, self._reduced = self._minimized(y), y.copy(), None
        return self._system

    def _minimized(self, y: Array) -> NormalEquations:
        """Newton steps of each landmark, shortened where the cost grows, until no decrease is predicted."""
        d, fixed, landmarks = self.problem.data, self.problem.fixed, self.landmarks
        system = self._newton.normal_equations(fixed, np.concatenate([y, landmarks]))
        before = self._of_landmarks(y, landmarks)
        for _ in range(INNER):
            step = -np.linalg.solve(system.C + 1e-12 * np.eye(3), system.h[:, :, None])[:, :, 0]
            predicted = -0.5 * float(np.sum(step * system.h))
            if not predicted > INNER_TOLERANCE * max(system.cost, 1.0):
                break
            length = np.ones(d.n_landmarks)
            for _ in range(8):
                moved = (landmarks.reshape(-1, 3) + length[:, None] * step).ravel()
                after = self._of_landmarks(y, moved)
                worse = ~(after <= before)
                if not worse.any():
                    break
                length[worse] *= 0.25
            length[~(after <= before)] = 0.0
            landmarks = (landmarks.reshape(-1, 3) + length[:, None] * step).ravel()
            before = self._of_landmarks(y, landmarks)
            system = self._newton.normal_equations(fixed, np.concatenate([y, landmarks]))
        if np.isfinite(system.cost):
            self.landmarks = landmarks
        return system

    def _of_landmarks(self, y: Array, landmarks: Array) -> Array:
        """Robust cost of each landmark's measurements (L,)."""
        d = self.problem.data
        residuals, _ = self._newton.residuals(self.problem.fixed, np.concatenate([y, landmarks]))
        c = d.robust_scale
        each = 0.5 * c**2 * np.log1p(np.sum(residuals**2, axis=1) / c**2)
        return np.asarray(np.bincount(d.landmark, each, d.n_landmarks), dtype=np.float64)


class Condensed:
    """IPOPT over the reduced cost."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """With the tolerances of the back end's program."""
        with monitor.part("build"):
            reduced = ReducedCost(problem, x, monitor)
            n = reduced.n
            y = ca.MX.sym("y", n)
            kinds = ((reduced.cost, 1), (reduced.gradient, n), (reduced.hessian, n * (n + 1) // 2))
            outside = [ExternalFunction(f.__name__, f, (n,), size) for f, size in kinds]
            cost, gradient, second = (function(y) for function in outside)
            options = MotionProgram(problem.data).options(MAX_ITERATIONS, max(monitor.left(), 0.1))
            iterations = Iterations(n, 0, monitor, reduced.whole)
            options["iteration_callback"] = iterations
            hessian = ca.Sparsity.upper(n), second
            solver = ipopt_solver("condensed", options, y, ca.MX.sym("p", 0), cost, gradient, hessian)
        result = solver(x0=x[:n])
        stats = solver.stats()
        status = str(stats["return_status"])
        found = reduced.whole(np.asarray(result["x"]).ravel())
        monitor.check()
        return AdapterResult(found, status in OPTIMAL, int(stats["iter_count"]), MESSAGES.get(status, status))
