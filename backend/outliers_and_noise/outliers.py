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
from polhode.backend.solvers.linearization_point import linearization_point
from polhode.backend.solvers.robust_kernel import most_efficient_scale, robust_weight
from polhode.errors import RunFailure
from polhode.lie import Array
from polhode.records import Bools

MAD_TO_SIGMA = 1.4826
LIMITS = (0.05, 6.0)
"""Scales beyond these limits mean that the measurements do not fit the motion."""
MAX_TAKEN_BY_POSES = 0.3
"""Largest share of the freedom of u and v that the poses are taken to use up."""
MIN_OBSERVATIONS = 30
"""With fewer repeated observations their noise is not estimated."""
GATE = 4.5
"""Largest norm of a whitened stereo residual that is kept; 1 in 5700 Gaussian ones is larger."""
MIN_LEFT = 3
"""A landmark that lost observations is kept if this number is left, or two of at most four."""

ROUNDS = 2
ITERATIONS = 3
"""Gauss-Newton iterations after each pruning."""
MIN_SHARE = 0.3
"""Share of observations that must agree with the motion."""


@dataclass(frozen=True)
class NoiseScales:
    """Factors on the stated standard deviations of (u, v) and of the disparity."""

    uv: float
    disparity: float

    def times(self, other: "NoiseScales") -> "NoiseScales":
        """Product of both scales."""
        return NoiseScales(self.uv * other.uv, self.disparity * other.disparity)

    @property
    def factors(self) -> Array:
        """(3,) for u, v and disparity."""
        return np.array([self.uv, self.uv, self.disparity])


def estimate_noise(data: MotionData, iterate: Iterate, robust: bool) -> NoiseScales:
    """Scatter of the whitened residuals, each corrected for the degrees of freedom used by the fit.

    ``robust``: median absolute deviation, for data with outliers; otherwise the root mean square. A landmark
    that is seen from several directions is fitted to its u and v; its disparities stay almost free.
    """
    residuals, (A, p_NG, p_G) = GaussNewton(data).residuals(
        linearization_point(data, iterate), iterate.vector()
    )
    repeated = np.diff(data.start)[data.landmark] >= 2
    if repeated.sum() < MIN_OBSERVATIONS:
        return NoiseScales(1.0, 1.0)
    weight = robust_weight(np.sum(residuals**2, axis=1), data.robust_scale)
    taken = landmark_leverage(data, A, p_NG, p_G, weight)
    # the poses are fitted to u and v too: six unknowns for the two numbers of each observation
    taken[:, :2] += min(3.0 * len(np.unique(data.frame)) / len(data.frame), MAX_TAKEN_BY_POSES)
    free = np.maximum(1.0 - taken[repeated], 0.05)
    if robust:
        return scales_by_median(residuals[repeated], free)
    squares, freedom = np.sum(residuals[repeated] ** 2, axis=0), np.sum(free, axis=0)
    return _limited(np.sqrt([squares[:2].sum() / freedom[:2].sum(), squares[2] / freedom[2]]))


def scales_by_median(residuals: Array, free: Array) -> NoiseScales:
    """Scales by the median absolute deviation; residuals (M, 3), ``free`` (M, 3) their share of freedom."""
    whitened = np.abs(residuals) / np.sqrt(free)
    return _limited(MAD_TO_SIGMA * np.array([np.median(whitened[:, :2]), np.median(whitened[:, 2])]))


def _limited(scales: Array) -> NoiseScales:
    uv, disparity = np.clip(scales, *LIMITS)
    return NoiseScales(float(uv), float(disparity))


def landmark_leverage(data: MotionData, A: Array, p_NG: Array, p_G: Array, weight: Array) -> Array:
    """Share (M, 3) of the freedom of each residual that is used by its landmark, poses given.

    A (F, 3, 3) = R_RN R_NG, p_NG (F, 3), p_G (L, 3), robust weights (M,).
    """
    mark, J = data.landmark, data.point_jacobians(A, p_NG, p_G) @ A[data.frame]
    information = np.zeros((data.n_landmarks, 3, 3))
    np.add.at(information, mark, weight[:, None, None] * (np.swapaxes(J, 1, 2) @ J))
    # a landmark that contradicts all its observations has almost no information
    information += 1e-12 * (1.0 + np.trace(information, axis1=1, axis2=2))[:, None, None] * np.eye(3)
    # a landmark whose observations have no weight uses no freedom
    least = 1e-12 * np.trace(information, axis1=1, axis2=2) + 1e-300
    inverse = np.linalg.inv(information + least[:, None, None] * np.eye(3))
    return np.asarray(weight[:, None] * np.einsum("mij,mjk,mik->mi", J, inverse[mark], J))


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
