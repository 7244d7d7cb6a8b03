"""Noise of the pixels, from the residuals, and removal of observations that contradict the motion.

A Cauchy kernel only bounds the effect of a wrong observation. Many of them together still bias the solution,
and the solver needs dozens of iterations for landmarks whose observations contradict each other.
"""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.initialization.rates import FAST_HINT
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.robust_kernel import most_efficient_scale, robust_weight
from polhode.geometry.lie import Array, Bools
from polhode.runtime.errors import RunFailure

MAX_SHARE_OF_POSES = 0.3
"""Largest share of the freedom of u and v that the poses are taken to use up."""
MIN_OBSERVATIONS = 30
"""With fewer repeated observations their noise is not estimated."""
STEREO_GATE = 4.5
"""Largest norm of a whitened stereo residual that is kept; 1 in 5700 Gaussian ones is larger."""
MIN_AGREEING_SHARE = 0.3
"""Share of observations that must agree with the motion."""


def estimate_noise(fit: MotionFit, robust: bool) -> Array:
    """Factors (3,) on the stated standard deviations of u, v and disparity, from the whitened residuals.

    Their scatter is corrected for the degrees of freedom used by the fit.

    ``robust``: median absolute deviation, for data with outliers; otherwise the root mean square. A landmark
    that is seen from several directions is fitted to its u and v; its disparities stay almost free.
    """
    data = fit.data
    residuals, (A, p_NG, p_G) = GaussNewton(data).residuals(fit.linearized(), fit.iterate.vector())
    repeated = np.diff(data.start)[data.landmark] >= 2
    if repeated.sum() < MIN_OBSERVATIONS:
        return np.ones(3)
    weight = robust_weight(np.sum(residuals**2, axis=1), data.robust_scale)
    used = _landmark_leverage(data, data.point_jacobians(A, p_NG, p_G) @ A[data.frame], weight)
    # the poses are fitted to u and v too: six unknowns for the two numbers of each observation
    used[:, :2] += min(3.0 * len(np.unique(data.frame)) / len(data.frame), MAX_SHARE_OF_POSES)
    free = np.maximum(1.0 - used[repeated], 0.05)
    if robust:
        return scales_by_median(residuals[repeated], free)
    squares, freedom = np.sum(residuals[repeated] ** 2, axis=0), np.sum(free, axis=0)
    return _limited(np.sqrt([squares[:2].sum() / freedom[:2].sum(), squares[2] / freedom[2]]))


def scales_by_median(residuals: Array, free: Array) -> Array:
    """Scales by the median absolute deviation; residuals (M, 3), ``free`` (M, 3) their share of freedom."""
    whitened = np.abs(residuals) / np.sqrt(free)
    return _limited(1.4826 * np.array([np.median(whitened[:, :2]), np.median(whitened[:, 2])]))


def _limited(scales: Array) -> Array:
    # scales beyond these limits mean that the measurements do not fit the motion
    uv, disparity = np.clip(scales, 0.05, 6.0)
    return np.array([uv, uv, disparity])


def _landmark_leverage(data: MotionData, J: Array, weight: Array) -> Array:
    """Share (M, 3) of the freedom of each residual that is used by its landmark, poses given."""
    information = np.zeros((data.n_landmarks, 3, 3))
    np.add.at(information, data.landmark, weight[:, None, None] * (np.swapaxes(J, 1, 2) @ J))
    # a landmark that contradicts all its observations has almost no information
    information += 1e-12 * (1.0 + np.trace(information, axis1=1, axis2=2))[:, None, None] * np.eye(3)
    # a landmark whose observations have no weight uses no freedom
    least = 1e-12 * np.trace(information, axis1=1, axis2=2) + 1e-300
    inverse = np.linalg.inv(information + least[:, None, None] * np.eye(3))
    return np.asarray(weight[:, None] * np.einsum("mij,mjk,mik->mi", J, inverse[data.landmark], J))


@dataclass(frozen=True)
class PrunedProblem:
    """A problem without its outliers, and which parts of the whole problem it keeps."""

    data: MotionData
    observations: Bools
    """(M,) observations of the whole problem that are kept"""
    landmarks: Bools
    """(L,) landmarks of the whole problem that are kept"""

    def restrict(self, iterate: Iterate) -> MotionFit:
        """The pruned problem at the unknowns of the whole one."""
        return MotionFit(self.data, replace(iterate, p_G=iterate.p_G[self.landmarks]))

    def expand(self, small: Iterate, whole: Iterate) -> Iterate:
        """All landmarks again; those that were removed stay as they are in ``whole``."""
        p_G = whole.p_G.copy()
        p_G[self.landmarks] = small.p_G
        return replace(small, p_G=p_G)


@dataclass(frozen=True)
class PrunedFit:
    """A motion, the problem with the noise estimated from the data, and what is kept of it."""

    data: MotionData
    """all observations"""
    kept: PrunedProblem
    iterate: Iterate
    """with all landmarks"""
    scales: Array
    """(3,) on the stated standard deviations of u, v and disparity"""

    @property
    def small(self) -> MotionFit:
        """The pruned problem."""
        return self.kept.restrict(self.iterate)

    def with_solution(self, small: Iterate) -> "PrunedFit":
        """With a solution of the pruned problem."""
        return replace(self, iterate=self.kept.expand(small, self.iterate))


def remove_outliers(fit: MotionFit) -> PrunedFit:
    """Separate noise from outliers.

    The median absolute deviation sets the first gate; the final noise is the scatter of the observations that
    are kept, and the robust kernel is as wide as that scatter allows. Raises RunFailure if most observations
    contradict the motion.
    """
    first = estimate_noise(fit, robust=True)
    data, iterate = fit.data.rescaled(first), fit.iterate
    kept = prune(MotionFit(data, iterate))
    for _ in range(2):
        small = kept.restrict(iterate)
        solution = GaussNewton(kept.data).solve(small.linearized(), small.iterate.vector(), 3)
        iterate = kept.expand(small.iterate.moved_to(solution.x), iterate)
        kept = prune(MotionFit(data, iterate))
    last = estimate_noise(kept.restrict(iterate), robust=False)
    data = data.rescaled(last)
    s = np.sum(whitened_residuals(MotionFit(data, iterate))[kept.observations] ** 2, axis=1)
    scale = most_efficient_scale(s, data.robust_scale)
    kept = replace(kept, data=replace(kept.data.rescaled(last), robust_scale=scale))
    return PrunedFit(replace(data, robust_scale=scale), kept, iterate, first * last)


def prune(fit: MotionFit) -> PrunedProblem:
    """The problem without the observations whose residual at the iterate exceeds the gate.

    A landmark that lost observations is kept if three are left, or two of at most four. Raises RunFailure if
    most observations contradict the motion.
    """
    data = fit.data
    agree = np.sum(whitened_residuals(fit) ** 2, axis=1) < STEREO_GATE**2
    seen, left = np.diff(data.start), np.bincount(data.landmark[agree], minlength=data.n_landmarks)
    landmarks = (left == seen) | (left >= 3) | ((left == 2) & (seen <= 4))
    observations = agree & landmarks[data.landmark]
    share = float(np.mean(observations))
    if not share >= MIN_AGREEING_SHARE:
        raise RunFailure(
            f"no consistent motion: only {share:.0%} of the observations agree with the best one found "
            f"({FAST_HINT})"
        )
    landmark = (np.cumsum(landmarks) - 1)[data.landmark[observations]]
    smaller = data.select(observations, landmark, int(landmarks.sum()))
    return PrunedProblem(smaller, observations, landmarks)


def whitened_residuals(fit: MotionFit) -> Array:
    """Stereo residuals over their standard deviations (M, 3)."""
    return GaussNewton(fit.data).residuals(fit.linearized(), fit.iterate.vector())[0]
