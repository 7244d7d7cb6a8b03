"""Which inertia: brief solves of the whole history from several guesses, the cheapest one taken."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.dynamics.kernels import N_CONSTANTS, N_STATE
from polhode.backend.initialization.hypotheses import inertia_hypotheses
from polhode.backend.initialization.initialize import interval_rates
from polhode.backend.problem.inertia import inertia_from_second_moments
from polhode.backend.window.estimator_state import Belief
from polhode.backend.window.history import History
from polhode.backend.window.newton import NewtonSolver
from polhode.backend.window.problem import WindowProblem
from polhode.backend.window.quadratic import Quadratic
from polhode.backend.window.steps import take_whole
from polhode.lie import Array

PASSES = (3, 3, 3, 2)
"""Iterations of the solves of one hypothesis; the whitening is renewed between them."""
SAME_BASIN = 0.03
"""Two inertias (second moments of determinant 1) closer than this will end in the same minimum."""
CLEARLY_BETTER = 1.0
"""What another basin must save in cost: below that the data do not tell, and the present one stays."""


@dataclass(frozen=True)
class Basin:
    """Where one guess led; the cost includes the normalisation of the process noise."""

    x: Array
    second: Array
    cost: float


def choose_basin(belief: Belief, history: History) -> str:
    """Move the history to the best inertia found, when it is clearly better. Returns its name."""
    sight = belief.sight()
    condensed = belief.condensed(sight)
    vision = history.vision(belief.active, condensed)
    before = history.vector(belief.active.constants)
    second = belief.shape.form.second_moments(belief.xi, belief.R_inertia)
    present = _descend(belief, history, vision.quadratic, before, second, [])
    found = [] if present is None else [present]
    best, name = present, "present"
    start, R_NG, w_G = _fresh_rates(history, before)
    for guess, second in inertia_hypotheses(R_NG, w_G).items():
        basin = _descend(belief, history, vision.quadratic, start, second, found)
        if basin is None or any(basin is other for other in found):
            continue
        found.append(basin)
        if best is None or basin.cost < best.cost - CLEARLY_BETTER:
            best, name = basin, guess
    if best is None:
        return "none"
    take_whole(belief, history, vision, condensed, best.x)
    belief.set_inertia(*belief.shape.form.coordinates(best.second))
    return name


def _fresh_rates(history: History, x: Array) -> tuple[Array, Array, Array]:
    """The unknowns with the rates by differences of the attitudes; attitudes (N, 3, 3) and rates (N, 3)."""
    R_NG = np.stack([frame.R_NG for frame in history.frames])
    time_s = np.array([frame.time_s for frame in history.frames])
    rates, centres = interval_rates(time_s, R_NG)
    w_G = np.stack([np.interp(time_s, centres, rates[:, axis]) for axis in range(3)], axis=1)
    fresh = x.copy()
    fresh[:-N_CONSTANTS].reshape(-1, N_STATE)[:, 9:12] = w_G
    return fresh, R_NG, w_G


def _descend(
    belief: Belief, history: History, vision: Quadratic, x: Array, second: Array, found: list[Basin]
) -> Basin | None:
    """A brief solve from one inertia; one of those found when it leads there, None when it diverges."""
    form, cost = belief.shape.form, np.inf
    x = x.copy()
    for iterations in PASSES:
        xi, R_inertia = form.coordinates(second)
        x[-len(xi) :] = xi
        weak = belief.weak_prior.copy()
        weak[4:] = R_inertia.T.ravel()
        J_G = inertia_from_second_moments(second)
        links = history.links(x, J_G, belief.J_noise, belief.disturbances)
        problem = WindowProblem(vision, history.R_ref, links, weak, belief.shape)
        try:
            solution = NewtonSolver().solve(problem, x, iterations)
        except LinAlgError:
            return None
        x, cost = solution.x, solution.cost + links.half_log_det
        second = form.second_moments(x[-len(xi) :], R_inertia)
        for other in found:
            if np.abs(second - other.second).max() < SAME_BASIN:
                return other
    return Basin(x, second, float(cost)) if np.isfinite(cost) else None
