"""SciPy: ``least_squares`` with the sparse Jacobian of the common residuals."""

from typing import Any

import numpy as np
from scipy.optimize import least_squares

from polhode.compare.problem.blocks import Block, Blocks, root_of_kernel, stacked
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array

TOLERANCE = 1e-11
MAX_EVALUATIONS = 2000
UNREACHABLE = 1e30
"""Residual where the model cannot be evaluated: the step there is rejected."""


class TrustRegion:
    """Trust region reflective, steps by LSMR."""

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """With the kernel in the residuals: SciPy's own losses act on single numbers, not on vectors."""
        with monitor.part("build"):
            blocks = Blocks(problem.data, problem.fixed)
            cached = _CachedBlocks(blocks, monitor)
        found: Any = least_squares(
            cached.residual,
            x,
            jac=cached.jacobian,
            method="trf",
            tr_solver="lsmr",
            x_scale="jac",
            ftol=TOLERANCE,
            xtol=1e-12,
            gtol=1e-6,
            max_nfev=MAX_EVALUATIONS,
        )
        return AdapterResult(found.x, found.status > 0, int(found.njev), " ".join(str(found.message).split()))


class _CachedBlocks:
    """Evaluates the blocks once a point, for separate calls of residuals and Jacobian."""

    def __init__(self, blocks: Blocks, monitor: SolveMonitor) -> None:
        self.blocks, self.monitor = blocks, monitor
        self._x: Array | None = None
        self._value: tuple[Array, Any] = np.zeros(0), None

    def residual(self, x: Array) -> Array:
        """(n,) whose plain squares are twice the common cost."""
        self.monitor.check()
        residual = self._at(x)[0]
        return residual if np.isfinite(residual).all() else np.full_like(residual, UNREACHABLE)

    def jacobian(self, x: Array) -> Any:
        """Sparse (n, n_x); called once an iteration."""
        residual, jacobian = self._at(x)
        self.monitor.record(0.5 * float(residual @ residual), x)
        return jacobian

    def _at(self, x: Array) -> tuple[Array, Any]:
        if self._x is None or not np.array_equal(x, self._x):
            with self.monitor.part("evaluation"), np.errstate(over="ignore", invalid="ignore"):
                scale = self.blocks.data.robust_scale
                blocks: list[Block] = [root_of_kernel(block, scale) for block in self.blocks.all(x)]
                self._value, self._x = stacked(blocks, self.blocks.n_x), x.copy()
        return self._value
