"""Gauss-Newton on the window's program, with damping of the centre of mass and the inertia."""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from polhode.backend.problem.iterate import N_CONSTANTS
from polhode.backend.solvers.gauss_newton import CONSTANT_SCALE, Solution
from polhode.backend.window.problem import WindowProblem
from polhode.lie import Array

AT_REST = 1e-3
"""Negligible difference of the cost, which is half a squared number of standard deviations."""
DAMPINGS = (0.0, 1e-1, 1e1, 1e3, 1e5)
"""Damping of the constants, in units of ``CONSTANT_SCALE``."""
SHORTEST = 1e-3
"""Smallest fraction of a step that is tried."""


class NewtonSolver:
    """Reference solver; near the solution one step is enough.

    Given the constants the states are almost linear, and stiff at high frame rates: only the constants are
    damped, the states follow them freely. If that is not enough the step is shortened.
    """

    name = "gauss_newton"

    def solve(self, problem: WindowProblem, x: Array, max_iterations: int) -> Solution:
        """Minimize from x (12 W + 8,), until the cost after a step agrees with its quadratic model."""
        level, iteration = 0, 0
        cost, H, g = problem.normal_equations(x)
        candidate = cost
        for iteration in range(1, max_iterations + 1):
            step, candidate, level = _descending_step(problem, x, cost, H, g, level)
            if step is None:
                return Solution(x, cost, iteration, False, "no further decrease")
            expected = cost + float(g @ step + 0.5 * step @ (H @ step))
            x, exact = x + step, level == 0 and abs(candidate - expected) < AT_REST
            if exact:
                return Solution(x, candidate, iteration, True, "converged")
            level = max(level - 1, 0)
            if iteration < max_iterations:
                cost, H, g = problem.normal_equations(x)
        return Solution(x, candidate, iteration, False, "iteration limit")


def _descending_step(
    problem: WindowProblem, x: Array, cost: float, H: Array, g: Array, level: int
) -> tuple[Array | None, float, int]:
    """A step after which the cost is no higher, that cost, and the level of damping that was needed."""
    step = None
    for tried in range(level, len(DAMPINGS)):
        step = _damped_step(H, g, DAMPINGS[tried])
        if step is not None and (candidate := problem.cost(x + step)) <= cost + AT_REST:
            return step, candidate, tried
    share = 0.5
    while step is not None and share > SHORTEST:
        if (candidate := problem.cost(x + share * step)) <= cost + AT_REST:
            return share * step, candidate, len(DAMPINGS) - 1
        share *= 0.5
    return None, cost, level


def _damped_step(H: Array, g: Array, damping: float) -> Array | None:
    if damping > 0.0:
        H = H.copy()
        np.einsum("ii->i", H)[-N_CONSTANTS:] += damping / CONSTANT_SCALE**2
    try:
        factor = cho_factor(H, lower=True, check_finite=False)
    except LinAlgError:
        return None
    return np.asarray(-cho_solve(factor, g, check_finite=False))
