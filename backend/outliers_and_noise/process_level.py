"""Level of the disturbances: the process noise that makes the measurements most likely.

The evidence of a level q = (acceleration, torque) is Laplace's approximation: states, landmarks and constants
are fitted under q and integrated out as a Gaussian (Bishop, "Pattern Recognition and Machine Learning", 2006,
4.4)::

    -ln p(data | q) = cost(x_q) + 1/2 ln det Lambda(q) + 1/2 ln det H(x_q) + constant

Lambda is the covariance of the process noise over all steps and H the Gauss-Newton Hessian. Both levels are
searched in turn, in logarithmic steps. A short sequence hardly distinguishes levels below what it can
resolve; then the most likely level is often far too low, and every sigma with it. The result is therefore the
largest level, up to the stated one, that is nearly as likely as the best.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.chain import half_log_det
from polhode.backend.solvers.condensed import CondensedGaussNewton, VisionExpansion, without_landmarks
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import TIGHT_GAUGE, linearization_point
from polhode.lie import Array

T = TypeVar("T")
"""A level and what was found under it."""
FLOOR_PSD, CEILING_PSD = 1e-10, 1e-2
"""Below the floor nothing changes within a minute; above the ceiling the body is not free."""
FIRST_STEP, LAST_STEP = 1.0, 0.5
"""Steps of the search [decades]: finer than the data can resolve."""
START_FACTORS, START_ITERATIONS = (1.0, 1e-2, 1e-4), 10
"""Of the stated levels: too high a level can hide in wrong constants and so remain high."""
INDIFFERENT = 2.0
"""Difference of log-evidence that is not significant."""
ACCELERATION, TORQUE = 0, 1
"""Indices of the two levels."""
ITERATIONS = 3
"""Gauss-Newton iterations at each level, from the solution at the neighbouring level."""
SMALL_DECREASE = 0.01
"""A smaller decrease of the cost ends them: it changes no comparison of evidences."""
EXPANSIONS, AGREEING = 3, 0.5
"""Searches with stereo terms expanded again, until the problem itself has the same evidence within this."""


@dataclass(frozen=True)
class LevelFit:
    """A process noise, the motion fitted under it, and minus the logarithm of its evidence."""

    data: MotionData
    iterate: Iterate
    minus_log_evidence: float


@dataclass(frozen=True)
class LevelTrial:
    """A process noise in a search, what was fitted under it, and minus the logarithm of its evidence."""

    data: MotionData
    x: Array
    """(n,) states and constants, about the search's expansion"""
    minus_log_evidence: float


class LevelSearch:
    """Fits under many levels, with the stereo terms expanded about one iterate.

    The levels change how the steps between frames are weighted, not the measurements. Their expansion costs
    one elimination of the landmarks; a level then costs a quarter of ``fit_level``.
    """

    def __init__(self, data: MotionData, iterate: Iterate) -> None:
        self._vision = VisionExpansion.of(data, iterate)
        self.start = without_landmarks(iterate)

    def fit(self, data: MotionData, x: Array, iterations: int = ITERATIONS) -> LevelTrial:
        """Fit from x (n,) under the noise of ``data``, whose measurements are the same."""
        solver = CondensedGaussNewton(data, self._vision)
        fixed = solver.linearization_point()
        try:
            x, cost, half_log_det = solver.solve_roughly(fixed, x, iterations, SMALL_DECREASE)
        except LinAlgError:
            return LevelTrial(data, x, np.inf)
        return LevelTrial(data, x, cost + fixed.half_log_det + half_log_det)

    def fitted(self, trial: LevelTrial, iterations: int = ITERATIONS) -> LevelFit:
        """The fit of the problem itself under the level of a trial."""
        data = trial.data
        at = self._vision.iterate(trial.x)
        return fit_level(data, at, data.accel_psd, data.torque_psd, iterations)


def estimate_process_noise(data: MotionData, iterate: Iterate) -> LevelFit:
    """Most likely accel_psd and torque_psd between floor and ceiling, starting from those of ``data``."""
    stated = (data.accel_psd, data.torque_psd)
    search = LevelSearch(data, iterate)
    starts = {tuple(max(psd * factor, min(psd, FLOOR_PSD)) for psd in stated) for factor in START_FACTORS}
    trials = [
        search.fit(with_level(data, *levels), search.start, START_ITERATIONS)
        for levels in sorted(starts, reverse=True)
    ]
    found = search.fitted(min(trials, key=_minus_log_evidence), START_ITERATIONS)
    for _ in range(EXPANSIONS):
        search = LevelSearch(found.data, found.iterate)
        first = search.fit(found.data, search.start)
        best = _highest(search, first, stated)
        if best is first:
            break
        found = search.fitted(best, START_ITERATIONS)
        if abs(found.minus_log_evidence - best.minus_log_evidence) <= AGREEING:
            break
    return found


def _highest(search: LevelSearch, best: LevelTrial, stated: tuple[float, float]) -> LevelTrial:
    """From one level to the most likely one, and up to the largest that is nearly as likely."""
    step = FIRST_STEP
    while step >= LAST_STEP:
        for axis in (TORQUE, ACCELERATION):
            best = walk(best, partial(_neighbour, search, axis=axis, step=step), _minus_log_evidence)
        step *= 0.5
    for axis in (TORQUE, ACCELERATION):
        limit = best.minus_log_evidence + INDIFFERENT
        raised = partial(_raised, search, axis=axis, stated=stated[axis])
        best = climb(best, raised, _minus_log_evidence, limit)
    return best


def walk(start: T, neighbour: Callable[[T, int], T | None], cost: Callable[[T], float]) -> T:
    """Walk along one level while the cost falls: downwards, or upwards if the first step down raises it.

    neighbour(at, sign) is the next level downwards or upwards, None beyond the bounds.
    """
    for sign in (-1, 1):
        best = start
        while (trial := neighbour(best, sign)) is not None and cost(trial) < cost(best):
            best = trial
        if best is not start:
            return best
    return start


def climb(best: T, raised: Callable[[T], T | None], cost: Callable[[T], float], limit: float) -> T:
    """Raise one level towards the stated one (there ``raised`` is None) while the cost is below the limit."""
    while (trial := raised(best)) is not None and cost(trial) < limit:
        best = trial
    return best


def with_level(data: MotionData, accel_psd: float, torque_psd: float) -> MotionData:
    """The problem under another process noise."""
    return replace(data, accel_psd=accel_psd, torque_psd=torque_psd)


def _minus_log_evidence(fit: LevelTrial) -> float:
    return fit.minus_log_evidence


def _neighbour(search: LevelSearch, fit: LevelTrial, sign: int, axis: int, step: float) -> LevelTrial | None:
    """The fit with one level changed by a step [decades]; None at the floor or the ceiling."""
    levels = [fit.data.accel_psd, fit.data.torque_psd]
    changed = float(np.clip(levels[axis] * 10.0 ** (sign * step), FLOOR_PSD, CEILING_PSD))
    if changed == levels[axis]:
        return None
    levels[axis] = changed
    return search.fit(with_level(fit.data, *levels), fit.x)


def _raised(search: LevelSearch, fit: LevelTrial, axis: int, stated: float) -> LevelTrial | None:
    """The fit with one level raised towards the stated one; None when it is there."""
    levels = [fit.data.accel_psd, fit.data.torque_psd]
    if not levels[axis] < 0.99 * stated:
        return None
    levels[axis] = min(levels[axis] * 10.0**LAST_STEP, stated)
    return search.fit(with_level(fit.data, *levels), fit.x)


def fit_level(
    data: MotionData, iterate: Iterate, accel_psd: float, torque_psd: float, iterations: int = ITERATIONS
) -> LevelFit:
    """Fit under a level, with its evidence; infinitely unlikely where the fit fails."""
    data = with_level(data, accel_psd, torque_psd)
    solver, fixed = GaussNewton(data), linearization_point(data, iterate, TIGHT_GAUGE)
    try:
        solution = solver.solve(fixed, iterate.vector(), iterations)
        system = solver.normal_equations(fixed, solution.x)
        reduced, _, _ = solver.reduced(system)
        half_log_det_dense = half_log_det(reduced, data.n_frames, system.n_state)
    except LinAlgError:
        return LevelFit(data, iterate, np.inf)
    half_log_det_marks = 0.5 * float(np.linalg.slogdet(system.C)[1].sum())
    minus_log_evidence = system.cost + fixed.half_log_det + half_log_det_dense + half_log_det_marks
    return LevelFit(data, iterate.moved_to(solution.x), minus_log_evidence)
