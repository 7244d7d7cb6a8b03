"""How strongly the target is disturbed: the evidence of ``process_level.py``, on the history alone.

The landmarks are condensed in it, and their part of the evidence does not depend on the level.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError, cholesky

from polhode.backend.noise.process_level import CEILING_PSD, FLOOR_PSD, INDIFFERENT
from polhode.backend.window.estimator_state import Belief
from polhode.backend.window.history import History
from polhode.backend.window.newton import NewtonSolver
from polhode.backend.window.problem import WindowProblem

ITERATIONS = 3
DECADE = 0.5
"""Finest step of the search: finer than the data tell."""
STARTS = (0, -4, -8)
"""In these steps below the stated levels: a noise taken too strong can keep itself strong."""

Grid = tuple[int, int]
"""Levels of acceleration and torque in steps from the stated ones."""


def estimate_levels(belief: Belief, history: History, stated: tuple[float, float]) -> None:
    """Take the most likely accel_psd and torque_psd, from those stated."""
    vision = history.vision(belief.active, belief.condensed(belief.sight())).quadratic
    x = history.vector(belief.active.constants)

    def minus_log_evidence(at: Grid) -> float:
        levels = [value * 10.0 ** (DECADE * n) for value, n in zip(stated, at, strict=True)]
        if min(levels) < FLOOR_PSD or max(levels) > CEILING_PSD:
            return np.inf
        noise = replace(belief.disturbances, accel_psd=levels[0], torque_psd=levels[1])
        links = history.links(x, belief.J_G, belief.J_noise, noise)
        problem = WindowProblem(vision, history.R_ref, links, belief.weak_prior, belief.shape)
        try:
            solution = NewtonSolver().solve(problem, x, ITERATIONS)
            factor = cholesky(problem.normal_equations(solution.x)[1], lower=True, check_finite=False)
        except LinAlgError:
            return np.inf
        return solution.cost + links.half_log_det + float(np.log(np.diagonal(factor)).sum())

    best = most_likely(minus_log_evidence)
    accel_psd, torque_psd = (value * 10.0 ** (DECADE * n) for value, n in zip(stated, best, strict=True))
    belief.disturbances = replace(belief.disturbances, accel_psd=accel_psd, torque_psd=torque_psd)


def most_likely(minus_log_evidence: Callable[[Grid], float]) -> Grid:
    """The largest levels, up to the stated ones, that are nearly as likely as the best."""
    known: dict[Grid, float] = {}

    def cost(at: Grid) -> float:
        if at not in known:
            known[at] = minus_log_evidence(at)
        return known[at]

    best = min(((n, n) for n in STARTS), key=cost)
    for step in (2, 1):
        for axis in (1, 0):
            best = _walk(cost, best, axis, step)
    least = cost(best)
    for axis in (1, 0):
        while best[axis] < 0 and cost(_moved(best, axis, 1)) < least + INDIFFERENT:
            best = _moved(best, axis, 1)
    return best


def _walk(cost: Callable[[Grid], float], best: Grid, axis: int, step: int) -> Grid:
    """Along one of the levels, in the direction that the evidence rises, until it falls."""
    for sign in (-step, step):
        start = best
        while cost(_moved(best, axis, sign)) < cost(best):
            best = _moved(best, axis, sign)
        if best != start:
            break
    return best


def _moved(at: Grid, axis: int, step: int) -> Grid:
    return (at[0] + step, at[1]) if axis == 0 else (at[0], at[1] + step)
