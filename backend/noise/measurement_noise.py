"""Noise of the pixels, from the residuals."""

from dataclasses import dataclass

import numpy as np

from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import linearization_point
from polhode.backend.solvers.robust_kernel import robust_weight
from polhode.camera import stereo_jacobian
from polhode.lie import Array

MAD_TO_SIGMA = 1.4826
LIMITS = (0.05, 6.0)
"""Scales beyond these limits mean that the measurements do not fit the motion."""
MAX_TAKEN_BY_POSES = 0.3
"""Largest share of the freedom of u and v that the poses are taken to use up."""
MIN_OBSERVATIONS = 30
"""With fewer repeated observations their noise is not estimated."""


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
    k, mark = data.frame, data.landmark
    p_R = (
        np.einsum("mij,mj->mi", A[k], p_G[mark])
        + np.einsum("mij,mj->mi", data.R_RN[k], p_NG[k])
        + data.t_R[k]
    )
    J = data.inv_sigma[:, :, None] * (stereo_jacobian(p_R, data.rig[0], data.rig[3]) @ A[k])
    information = np.zeros((data.n_landmarks, 3, 3))
    np.add.at(information, mark, weight[:, None, None] * (np.swapaxes(J, 1, 2) @ J))
    # a landmark that contradicts all its observations has almost no information
    information += 1e-12 * (1.0 + np.trace(information, axis1=1, axis2=2))[:, None, None] * np.eye(3)
    # a landmark whose observations have no weight uses no freedom
    least = 1e-12 * np.trace(information, axis1=1, axis2=2) + 1e-300
    inverse = np.linalg.inv(information + least[:, None, None] * np.eye(3))
    return np.asarray(weight[:, None] * np.einsum("mij,mjk,mik->mi", J, inverse[mark], J))
