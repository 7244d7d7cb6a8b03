"""Level of the disturbances after the data: its posterior, from the evidence of some levels.

The evidence falls steeply towards levels that the motion does not show, and is flat below what the
measurements resolve, where the prior decides. The posterior of one level is that with the other one at its
most likely value: the evidence of one hardly depends on the other. Its mean power stands for it, as
covariances are linear in the power where disturbances limit them: that of the mean is the mean of all.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import LinAlgError

from polhode.backend.problem.level_prior import STEP, LevelPrior

Grid = tuple[int, int]
"""Levels of acceleration and torque, in steps from the stated ones."""
ACCELERATION, TORQUE = 0, 1
"""Indices of the two levels."""
STARTS = ((0, 0), (-8, -8), (-16, -16))
"""Too high a level can hide in wrong constants and so remain high: lower ones are tried first."""
OFFSETS = (1, 2, 4, *range(8, 64, 4))
"""Steps from the most likely level at which the evidence is evaluated."""
NEGLIGIBLE, FLAT = 6.0, 0.05
"""Fall of the log posterior beyond which a level does not count; change of the log-evidence within a decade
that is none."""


class LevelPosterior(NamedTuple):
    """Both levels, of acceleration and torque, as far as they are known."""

    psd: tuple[float, float]
    """Mean powers"""
    decades: tuple[float, float]
    """Standard deviations of their logarithms [decades]"""


def posterior(prior: LevelPrior, minus_log_evidence: Callable[[float, float], float]) -> LevelPosterior:
    """The mean of each level, and the standard deviation of its logarithm.

    minus_log_evidence(accel_psd, torque_psd): up to a constant; ``inf`` where nothing fits. Raises
    LinAlgError where nothing fits under two neighbouring levels.
    """
    known: dict[tuple[float, float], float] = {}

    def misfit(at: Grid) -> float:
        levels = prior.level(ACCELERATION, at[ACCELERATION]), prior.level(TORQUE, at[TORQUE])
        if levels not in known:
            known[levels] = minus_log_evidence(*levels)
        return known[levels]

    def cost(at: Grid) -> float:
        return misfit(at) + float(prior.minus_log(STEP * np.array(at)).sum())

    best = min(STARTS, key=cost)
    for step in (4, 2):
        for axis in (TORQUE, ACCELERATION):
            best = _walk(best, axis, step, cost)
    accel, torque = (_moments(prior, best, axis, misfit) for axis in (ACCELERATION, TORQUE))
    return LevelPosterior((accel[0], torque[0]), (accel[1], torque[1]))


def _moved(at: Grid, axis: int, steps: int) -> Grid:
    return (at[0] + steps, at[1]) if axis == ACCELERATION else (at[0], at[1] + steps)


def _walk(start: Grid, axis: int, step: int, cost: Callable[[Grid], float]) -> Grid:
    """Along one level while the cost falls: downwards, or upwards if the first step down raises it."""
    for sign in (-step, step):
        best = start
        while cost(trial := _moved(best, axis, sign)) < cost(best):
            best = trial
        if best is not start:
            return best
    return start


def _moments(
    prior: LevelPrior, best: Grid, axis: int, misfit: Callable[[Grid], float]
) -> tuple[float, float]:
    """Mean of one level, and standard deviation of its logarithm [decades], the other as in ``best``."""
    evidence = {best[axis]: misfit(best)}

    def cost(at: int) -> float:
        return evidence[at] + float(prior.minus_log(np.array(STEP * at)))

    is_flat = False
    for sign in (1, -1):
        for offset in OFFSETS:
            at = best[axis] + sign * offset
            evidence[at] = misfit(_moved(best, axis, sign * offset))
            if not np.isfinite(evidence[at]):
                del evidence[at]
                break
            is_flat = sign < 0 and abs(evidence[at] - evidence.get(at + 4, np.inf)) < FLAT
            if is_flat or cost(at) > cost(best[axis]) + NEGLIGIBLE:
                break
    if len(evidence) < 2 or not np.isfinite(evidence[best[axis]]):
        raise LinAlgError("no level of the disturbances fits")
    decades = STEP * np.array(sorted(evidence))
    values = np.array([evidence[at] for at in sorted(evidence)])
    # below a flat evidence's end it stays so: down to six standard deviations below the prior's median
    lowest = min(decades[0], -7.0 * prior.decades) if is_flat else decades[0]
    x = np.linspace(lowest, decades[-1], 4001)
    minus_log = CubicSpline(decades, values)(np.maximum(x, decades[0])) + prior.minus_log(x)
    weight = np.exp(minus_log.min() - minus_log)
    weight /= weight.sum()
    mean = float(weight @ x)
    spread = float(np.sqrt(weight @ (x - mean) ** 2))
    return prior.stated[axis] * float(weight @ 10.0**x), spread
