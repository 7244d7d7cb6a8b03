"""One frame's depth aligned to the surface that other frames show: its pose, better known.

Every point of the depth map asks the field for its signed distance from the surface (Bylow et al.,
"Real-time camera tracking and 3D reconstruction using signed distance functions", 2013). Gauss-Newton
makes the distances small, with the frame's pose covariance as the prior, so that what the surface does not
determine (a ball's turn, a wall's sliding) stays as it was.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from polhode.camera import RectifiedRig
from polhode.lie import Array, exp_so3, inverse_pose, make_pose, right_jacobian_so3, transform_points
from polhode.mapping.fusion.depth_frame import FrameTensors
from polhode.mapping.fusion.interpolation import FieldSamples

MAX_SAMPLES = 3000
_ITERATIONS = 20
_STILL = 0.05
"""Converged when a step is less than this, in standard deviations."""
_KERNEL = 2.5
"""Width of the robust kernel, over the residuals' own scale."""
_ALIKE_PX = 12
"""Errors of the depth are alike over squares of this width: disparities come from windows of 7 px, and what
light and slant do is alike over more (docs/mapping.md has the figures)."""
_MIN_SAMPLES = 50
_SPREAD = 1.5
"""Other starts are so many standard deviations away."""
_MISFIT = 4.0
"""Squares of the distances, over what the sigmas say, of a frame that lies elsewhere."""
_IMPLAUSIBLE = float(chi2.isf(2.0 * 3.167e-5, 6))
"""Squared length of a correction of six numbers that is as rare as four sigma in one."""


@dataclass(frozen=True)
class DepthPoints:
    """Points of one depth map in G, at the pose as given; n of them."""

    p_G: Array
    """(n, 3) [m]"""
    variance_m2: Array
    """(n,) of the distance from the surface, without the pose's part"""
    independent: float
    """Number of independent measurements among these over n, at most 1"""


@dataclass(frozen=True)
class FrameAlignment:
    """Where a frame is, by the surface; p_R = X_RG (Exp(turn) p_G + shift), X_RG the pose as given."""

    correction: Array
    """(6,) shift [m], turn [rad] along G; 0 where it is refused"""
    covariance_G: Array
    """(6, 6) of the corrected pose, in the same convention about that pose; the prior's where refused"""
    refused: str | None
    """Why the pose stays; None: it was aligned"""

    def apply(self, X_RG: Array) -> Array:
        """The corrected pose (4, 4)."""
        return np.asarray(X_RG @ make_pose(exp_so3(self.correction[3:]), self.correction[:3]))


def distances(
    correction: Array, p_G: Array, lookup: Callable[[Array], FieldSamples]
) -> tuple[Array, Array, Array]:
    """Distances (n,) of the points (n, 3) from the surface once the pose is corrected by ``correction`` (6,),
    their derivatives (n, 6), their variances (n,) by the surface's; NaN where it is not known."""
    shift, turn = correction[:3], correction[3:]
    R, away = exp_so3(-turn), p_G - shift
    at = lookup(away @ R.T)
    along = at.gradient_G @ R
    # Exp(-(t + d)) q = Exp(-t) (q + hat(q) Jr(-t) d)
    by_turn = np.cross(along, away) @ right_jacobian_so3(-turn)
    return at.distance_m, np.hstack([-along, by_turn]), at.variance_m2


def align(
    points: DepthPoints, covariance_G: Array, lookup: Callable[[Array], FieldSamples], min_share: float
) -> FrameAlignment:
    """Align a frame to the surface; covariance_G (6, 6) of its pose, finite, may be singular.

    ``min_share`` of the points must lie where the surface is known.
    """
    stays = FrameAlignment(np.zeros(6), covariance_G, None)
    n, step, excess, posterior = len(points.p_G), np.inf, 1.0, covariance_G
    x = _start(points, covariance_G, lookup, min_share)
    for _ in range(_ITERATIONS):
        distance, J, variance = distances(x, points.p_G, lookup)
        known = np.isfinite(distance)
        if known.sum() < max(_MIN_SAMPLES, min_share * n):
            return replace(stays, refused="too little of what it shows is known")
        J, distance = J[known], distance[known]
        weight, excess = _weights(distance, points.variance_m2[known] + variance[known])
        A = J.T @ (weight[:, None] * J)
        gain = points.independent / excess
        # (C^-1 + A) without inverting C, which may be singular
        half = 0.5 * np.linalg.solve(np.eye(6) + gain * covariance_G @ A, covariance_G)
        posterior = np.asarray(half + half.T)
        target = posterior @ (gain * (A @ x - J.T @ (weight * distance)))
        moved = target - x
        step = max(float(moved @ np.linalg.pinv(posterior, hermitian=True) @ moved), 0.0) ** 0.5
        x = target
        if step < _STILL:
            break
    if step >= _STILL:
        return replace(stays, refused="it does not settle")
    if excess > _MISFIT:
        return replace(stays, refused="it does not fit the surface")
    if x @ np.linalg.pinv(covariance_G, hermitian=True) @ x > _IMPLAUSIBLE:
        return replace(stays, refused="it contradicts the motion")
    return FrameAlignment(x, _about(x, posterior), None)


def depth_points(frame: FrameTensors, X_RG: Array, rig: RectifiedRig) -> DepthPoints:
    """Evenly spaced pixels; ``frame`` keeps its sigma; X_RG (4, 4) the pose as given."""
    depth = frame.depth_m.cpu().numpy().astype(np.float64)
    pixel = np.flatnonzero(frame.weight.cpu().numpy() > 0)
    count = min(len(pixel), MAX_SAMPLES)
    some = pixel[np.linspace(0, len(pixel) - 1, count).astype(int)]
    v, u = np.divmod(some, depth.shape[1])
    z = depth[v, u]
    x, y = ((u + frame.u0 - rig.cx_px) / rig.focal_px, (v + frame.v0 - rig.cy_px) / rig.focal_px)
    p_R = np.column_stack([x * z, y * z, z])
    return DepthPoints(
        p_G=transform_points(inverse_pose(X_RG), p_R),
        variance_m2=frame.own_sigma_m.cpu().numpy().astype(np.float64)[v, u] ** 2,
        independent=min(1.0, len(pixel) / (_ALIKE_PX**2 * max(count, 1))),
    )


def _start(
    points: DepthPoints, covariance: Array, lookup: Callable[[Array], FieldSamples], min_share: float
) -> Array:
    """No correction (6,); where that lies beyond the band around the surface, a likely one that does not."""
    variances, axes = np.linalg.eigh(covariance)
    spread = _SPREAD * np.sqrt(np.maximum(variances, 0.0))[:, None] * axes.T
    best, most = np.zeros(6), -1
    for x in (best, *spread, *-spread):
        known = int(np.isfinite(distances(x, points.p_G, lookup)[0]).sum())
        if known > most:
            best, most = x, known
        if not best.any() and most >= min_share * len(points.p_G):
            break
    return best


def _weights(distance: Array, variance: Array) -> tuple[Array, float]:
    """Information (n,) of each distance (Geman and McClure's kernel), and the excess of their squares."""
    size = distance**2 / variance
    # 0.455: the median of the square of a standard normal number
    excess = max(float(np.median(size)) / 0.455, 1.0)
    return 1.0 / (1.0 + size / (_KERNEL**2 * excess)) ** 2 / variance, excess


def _about(x: Array, covariance: Array) -> Array:
    """The covariance (6, 6) of a correction x as that of the corrected pose."""
    T = np.zeros((6, 6))
    T[:3, :3], T[3:, 3:] = exp_so3(-x[3:]), right_jacobian_so3(x[3:])
    return np.asarray(T @ covariance @ T.T)
