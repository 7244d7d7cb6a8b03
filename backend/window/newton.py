"""Gauss-Newton with Levenberg damping on the window's program."""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from backend.gauss_newton import Solution
from backend.window.problem import WindowProblem
from polhode.lie import Array

AT_REST = 1e-3
"""Difference of the cost, half a squared number of standard deviations, that nobody would notice."""
WORST_DAMPING = 1e8


class NewtonSolver:
    """Reference solver; near the solution one step is enough."""

    name = "gauss_newton"

    def solve(self, problem: WindowProblem, x: Array, max_iterations: int) -> Solution:
        """Minimise from x (12 W + 8,). Ends when the cost after a step is what its quadratic model said."""
        damping, iteration = 0.0, 0
        cost, H, g = problem.normal_equations(x)
        for iteration in range(1, max_iterations + 1):
            while True:
                step = _damped_step(H, g, damping)
                candidate = problem.cost(x + step) if step is not None else np.inf
                if step is not None and candidate <= cost + AT_REST:
                    break
                damping = max(10.0 * damping, 1e-6)
                if damping > WORST_DAMPING:
                    return Solution(x, cost, iteration, True, "no further decrease")
            expected = cost + float(g @ step + 0.5 * step @ (H @ step))
            x, exact = x + step, damping < 1e-6 and abs(candidate - expected) < AT_REST
            if exact:
                return Solution(x, candidate, iteration, True, "converged")
            damping = 0.1 * damping if damping > 1e-6 else 0.0
            if iteration < max_iterations:
                cost, H, g = problem.normal_equations(x)
        return Solution(x, candidate, iteration, False, "iteration limit")


def _damped_step(H: Array, g: Array, damping: float) -> Array | None:
    damped = H + np.diag(damping * np.diagonal(H)) if damping else H
    try:
        factor = cho_factor(damped, lower=True, check_finite=False)
    except LinAlgError:
        return None
    return np.asarray(-cho_solve(factor, g, check_finite=False))
