"""How strongly the target is disturbed, from the data: the process noise that makes them most likely.

The evidence of a level q = (acceleration, torque) is Laplace's: states, landmarks and constants are fitted
under q and integrated out as a Gaussian (Bishop, "Pattern Recognition and Machine Learning", 2006, 4.4)::

    -ln p(data | q) = cost(x_q) + 1/2 ln det Lambda(q) + 1/2 ln det H(x_q) + constant

Lambda is the covariance of the process noise over all steps and H the Gauss-Newton Hessian. Both levels are
searched in turn, in logarithmic steps. A short sequence hardly tells levels apart that are below what it can
see; then the most likely one is far too small as often as not, and every sigma with it. So the answer is the
largest level, up to the stated one, that is nearly as likely as the best.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cholesky

from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import linearization_point

FLOOR_PSD, CEILING_PSD = 1e-10, 1e-2
"""Below the floor nothing changes within a minute; above the ceiling the body is not free."""
FIRST_STEP, LAST_STEP = 1.0, 0.5
"""Steps of the search [decades]: finer than the data tell."""
START_FACTORS, START_ITERATIONS = (1.0, 1e-2, 1e-4), 10
"""Of the stated levels: a noise taken too strong can hide in wrong constants, and so keep itself strong."""
INDIFFERENT = 2.0
"""Difference of log-evidence that tells nothing."""
ITERATIONS = 3
"""Gauss-Newton steps at each level, from the solution at its neighbour."""


@dataclass(frozen=True)
class LevelFit:
    """A process noise, the motion fitted under it, and minus the logarithm of its evidence."""

    data: MotionData
    iterate: Iterate
    minus_log_evidence: float


def estimate_process_noise(data: MotionData, iterate: Iterate) -> LevelFit:
    """Most likely accel_psd and torque_psd between floor and ceiling, from those of ``data``."""
    starts = ((data.accel_psd * factor, data.torque_psd * factor) for factor in START_FACTORS)
    trials = [fit_level(data, iterate, *levels, START_ITERATIONS) for levels in starts]
    best = min(trials, key=lambda trial: trial.minus_log_evidence)
    step = FIRST_STEP
    while step >= LAST_STEP:
        for torque in (True, False):
            best = _descend(best, torque, step)
        step *= 0.5
    for torque in (True, False):
        best = _climb(best, torque, data.torque_psd if torque else data.accel_psd, best.minus_log_evidence)
    return best


def _climb(best: LevelFit, torque: bool, stated: float, least: float) -> LevelFit:
    """Raise one of the levels towards the stated one, as long as the evidence hardly falls."""
    accel_psd, torque_psd = best.data.accel_psd, best.data.torque_psd
    while (torque_psd if torque else accel_psd) < 0.99 * stated:
        there = min((torque_psd if torque else accel_psd) * 10.0**LAST_STEP, stated)
        accel_psd, torque_psd = (accel_psd, there) if torque else (there, torque_psd)
        trial = fit_level(best.data, best.iterate, accel_psd, torque_psd)
        if not trial.minus_log_evidence < least + INDIFFERENT:
            break
        best = trial
    return best


def _descend(start: LevelFit, torque: bool, step: float) -> LevelFit:
    """Walk along one of the two levels, in the direction that the evidence rises, until it falls."""
    for sign in (-1.0, 1.0):
        best, found = start, False
        while True:
            accel_psd, torque_psd = best.data.accel_psd, best.data.torque_psd
            factor = 10.0 ** (sign * step)
            here = torque_psd if torque else accel_psd
            there = float(np.clip(here * factor, FLOOR_PSD, CEILING_PSD))
            if there == here:
                break
            levels = (accel_psd, there) if torque else (there, torque_psd)
            trial = fit_level(best.data, best.iterate, *levels)
            if not trial.minus_log_evidence < best.minus_log_evidence:
                break
            best, found = trial, True
        if found:
            return best
    return start


def fit_level(
    data: MotionData, iterate: Iterate, accel_psd: float, torque_psd: float, iterations: int = ITERATIONS
) -> LevelFit:
    """Fit under a level and weigh it; infinite where the fit breaks down."""
    data = replace(data, accel_psd=accel_psd, torque_psd=torque_psd)
    solver, fixed = GaussNewton(data), linearization_point(data, iterate)
    try:
        solution = solver.solve(fixed, iterate.vector(), iterations)
        system = solver.normal_equations(fixed, solution.x)
        reduced, _, _ = solver.reduced(system)
        half_log_det_dense = float(np.log(np.diagonal(cholesky(reduced, lower=True))).sum())
    except LinAlgError:
        return LevelFit(data, iterate, np.inf)
    half_log_det_marks = 0.5 * float(np.linalg.slogdet(system.C)[1].sum())
    minus_log_evidence = system.cost + fixed.half_log_det + half_log_det_dense + half_log_det_marks
    return LevelFit(data, iterate.moved_to(solution.x), minus_log_evidence)
