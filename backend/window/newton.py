"""Gauss-Newton on the window's program, damped where the centre of mass and the inertia would go too far."""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from backend.gauss_newton import Solution
from backend.identifiability import CONSTANT_SCALE
from backend.kernels import N_CONSTANTS
from backend.window.problem import WindowProblem
from polhode.lie import Array

AT_REST = 1e-3
"""Difference of the cost, half a squared number of standard deviations, that nobody would notice."""
DAMPINGS = (0.0, 1e-1, 1e1, 1e3, 1e5)
"""Of the constants, in units of ``CONSTANT_SCALE``."""
SHORTEST = 1e-3
"""Share of a step that is tried last."""


class NewtonSolver:
    """Reference solver; near the solution one step is enough.

    Given the constants the states are almost linear, and where frames follow fast they are stiff: only the
    constants are damped, the states follow them freely. When that is not enough the step is shortened.
    """

    name = "gauss_newton"

    def solve(self, problem: WindowProblem, x: Array, max_iterations: int) -> Solution:
        """Minimise from x (12 W + 8,). Ends when the cost after a step is what its quadratic model said."""
        level, iteration = 0, 0
        cost, H, g = problem.normal_equations(x)
        for iteration in range(1, max_iterations + 1):
            share = 1.0
            step = _damped_step(H, g, DAMPINGS[level])
            while True:
                candidate = np.inf if step is None else problem.cost(x + share * step)
                if candidate <= cost + AT_REST:
                    break
                if level + 1 < len(DAMPINGS):
                    level += 1
                    step = _damped_step(H, g, DAMPINGS[level])
                else:
                    share *= 0.5
                if step is None or share < SHORTEST:
                    return Solution(x, cost, iteration, False, "no further decrease")
            step = share * step
            expected = cost + float(g @ step + 0.5 * step @ (H @ step))
            x, exact = x + step, level == 0 and abs(candidate - expected) < AT_REST
            if exact:
                return Solution(x, candidate, iteration, True, "converged")
            level = max(level - 1, 0)
            if iteration < max_iterations:
                cost, H, g = problem.normal_equations(x)
        return Solution(x, candidate, iteration, False, "iteration limit")


def _damped_step(H: Array, g: Array, damping: float) -> Array | None:
    if damping > 0.0:
        H = H.copy()
        np.einsum("ii->i", H)[-N_CONSTANTS:] += damping / CONSTANT_SCALE**2
    try:
        factor = cho_factor(H, lower=True, check_finite=False)
    except LinAlgError:
        return None
    return np.asarray(-cho_solve(factor, g, check_finite=False))
