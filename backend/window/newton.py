"""Gauss-Newton with Levenberg damping on the window's program."""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from backend.gauss_newton import Solution
from backend.window.problem import WindowProblem
from polhode.lie import Array

SMALL_DECREMENT = 1e-3
"""Half the squared length of the step in its own metric: the cost that the step still takes off."""
WORST_DAMPING = 1e8


class NewtonSolver:
    """Reference solver; near the solution one step is enough."""

    name = "gauss_newton"

    def solve(self, problem: WindowProblem, x: Array, max_iterations: int) -> Solution:
        """Minimise from x (12 W + 8,)."""
        damping, cost = 0.0, problem.cost(x)
        iteration = 0
        for iteration in range(1, max_iterations + 1):
            H, g = problem.normal_equations(x)
            while True:
                step = _damped_step(H, g, damping)
                candidate = problem.cost(x + step) if step is not None else np.inf
                if step is not None and candidate <= cost + 1e-9 * max(abs(cost), 1.0):
                    break
                damping = max(10.0 * damping, 1e-6)
                if damping > WORST_DAMPING:
                    return Solution(x, cost, iteration, True, "no further decrease")
            x, cost, damping = x + step, candidate, 0.1 * damping if damping > 1e-6 else 0.0
            if -0.5 * float(g @ step) < SMALL_DECREMENT:
                return Solution(x, cost, iteration, True, "converged")
        return Solution(x, cost, iteration, False, "iteration limit")


def _damped_step(H: Array, g: Array, damping: float) -> Array | None:
    try:
        factor = cho_factor(H + np.diag(damping * np.diagonal(H)), lower=True, check_finite=False)
    except LinAlgError:
        return None
    return np.asarray(-cho_solve(factor, g, check_finite=False))
