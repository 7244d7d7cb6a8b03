"""Removal of observations that contradict the motion.

A Cauchy kernel only bounds the effect of a wrong observation. Many of them together still bias the solution,
and the solver needs dozens of iterations for landmarks whose observations contradict each other.
"""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.initialization.rotation_direction import FAST_HINT
from polhode.backend.noise.measurement_noise import NoiseScales, estimate_noise
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import linearization_point
from polhode.backend.solvers.robust_kernel import most_efficient_scale
from polhode.errors import RunFailure
from polhode.lie import Array
from polhode.records import Bools

GATE = 4.5
"""Largest norm of a whitened stereo residual that is kept; 1 in 5700 Gaussian ones is larger."""
MIN_LEFT = 3
"""A landmark that lost observations is kept with so many, or with two that are half of them."""

ROUNDS = 2
ITERATIONS = 3
"""Gauss-Newton iterations after each pruning."""
MIN_SHARE = 0.3
"""Share of observations that must agree with the motion."""


@dataclass(frozen=True)
class PrunedProblem:
    """A problem without its outliers, and which parts of the whole problem it keeps."""

    data: MotionData
    observations: Bools
    """(M,) observations of the whole problem that are kept"""
    landmarks: Bools
    """(L,) landmarks of the whole problem that are kept"""

    def restrict(self, iterate: Iterate) -> Iterate:
        """The unknowns of the pruned problem."""
        return replace(iterate, p_G=iterate.p_G[self.landmarks])

    def expand(self, small: Iterate, whole: Iterate) -> Iterate:
        """All landmarks again; those that were removed stay as they are in ``whole``."""
        p_G = whole.p_G.copy()
        p_G[self.landmarks] = small.p_G
        return replace(small, p_G=p_G)


def remove_outliers(
    data: MotionData, iterate: Iterate
) -> tuple[MotionData, PrunedProblem, Iterate, NoiseScales]:
    """Separate noise from outliers: data with its noise, the pruned problem, motion, noise factors.

    The median absolute deviation sets the first gate; the final noise is the scatter of the observations that
    are kept, and the robust kernel is as wide as that scatter allows. Raises RunFailure if most observations
    contradict the motion.
    """
    first = estimate_noise(data, iterate, robust=True)
    data = data.rescaled(first.factors)
    kept = prune(data, iterate)
    for _ in range(ROUNDS):
        small = kept.restrict(iterate)
        solution = GaussNewton(kept.data).solve(
            linearization_point(kept.data, small), small.vector(), ITERATIONS
        )
        iterate = kept.expand(small.moved_to(solution.x), iterate)
        kept = prune(data, iterate)
    last = estimate_noise(kept.data, kept.restrict(iterate), robust=False)
    data = data.rescaled(last.factors)
    s = np.sum(whitened_residuals(data, iterate)[kept.observations] ** 2, axis=1)
    scale = most_efficient_scale(s, data.robust_scale)
    kept = replace(kept, data=replace(kept.data.rescaled(last.factors), robust_scale=scale))
    return replace(data, robust_scale=scale), kept, iterate, first.times(last)


def prune(data: MotionData, iterate: Iterate) -> PrunedProblem:
    """The problem without the observations whose residual at the iterate exceeds the gate.

    Raises RunFailure if most of them do.
    """
    residuals = whitened_residuals(data, iterate)
    agree = np.sum(residuals**2, axis=1) < GATE**2
    seen, left = np.diff(data.start), np.bincount(data.landmark[agree], minlength=data.n_landmarks)
    landmarks = (left == seen) | (left >= MIN_LEFT) | ((left == 2) & (seen <= 4))
    observations = agree & landmarks[data.landmark]
    share = float(np.mean(observations))
    if not share >= MIN_SHARE:
        raise RunFailure(
            f"no consistent motion: only {share:.0%} of the observations agree with the best one found "
            f"({FAST_HINT})"
        )
    number = np.cumsum(landmarks) - 1
    landmark = number[data.landmark[observations]]
    smaller = replace(
        data,
        frame=data.frame[observations],
        landmark=landmark,
        start=np.searchsorted(landmark, np.arange(int(landmarks.sum()) + 1)).astype(np.int64),
        uvd_px=data.uvd_px[observations],
        inv_sigma=data.inv_sigma[observations],
        order=data.order[observations],
    )
    return PrunedProblem(smaller, observations, landmarks)


def whitened_residuals(data: MotionData, iterate: Iterate) -> Array:
    """Stereo residuals over their standard deviations (M, 3)."""
    residuals, _ = GaussNewton(data).residuals(linearization_point(data, iterate), iterate.vector())
    return residuals
