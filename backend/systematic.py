"""Errors that every frame shares: no residual shows them, so no solver's covariance holds them.

A camera matrix that is off by a hundredth of a pixel, or a matcher that reads every disparity a little short,
moves the whole target. What such an offset of u, v and disparity does to a point at the target's place is
added to the covariance of the position; attitude, rates and mass properties hardly feel it.
"""

from dataclasses import replace

import numpy as np

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose, transform_points
from polhode.records import MotionEstimate, OnlineEstimate, StereoTracks

Sigma = tuple[float, float, float]
"""Standard deviations of the offsets of u, v, disparity [px]."""


def position_covariance(rig: RectifiedRig, X_NR: Array, r_N: Array, sigma_px: Sigma) -> Array:
    """Covariance (F, 3, 3) in N [m^2] of positions r_N (F, 3), seen from X_NR (F, 4, 4)."""
    r_R = transform_points(inverse_pose(X_NR), r_N[:, None])[:, 0]
    spread = X_NR[:, :3, :3] @ rig.triangulation_jacobian(r_R) * np.asarray(sigma_px)
    return np.asarray(spread @ np.swapaxes(spread, 1, 2))


def with_systematic(estimate: MotionEstimate, tracks: StereoTracks, sigma_px: Sigma) -> MotionEstimate:
    """The estimate with the covariance of its positions grown."""
    more = position_covariance(tracks.rig, tracks.X_NR, estimate.r_N, sigma_px)
    body = estimate.covariance_last_body
    return replace(
        estimate,
        covariance=_grown(estimate.covariance, more),
        covariance_last_joint=_grown(estimate.covariance_last_joint[None], more[-1:])[0],
        covariance_last_body=None if body is None else _grown(body[None], more[-1:])[0],
    )


def online_with_systematic(online: OnlineEstimate, tracks: StereoTracks, sigma_px: Sigma) -> OnlineEstimate:
    """The causal estimate with the covariance of its positions grown."""
    more = position_covariance(tracks.rig, tracks.X_NR, online.r_N, sigma_px)
    return replace(online, covariance=_grown(online.covariance, more))


def _grown(covariance: Array, more: Array) -> Array:
    """Covariances (F, n, n), the position first, with more (F, 3, 3); what is unknown stays so."""
    known = np.isfinite(np.diagonal(covariance, axis1=1, axis2=2)[:, :3])
    out = covariance.copy()
    out[:, :3, :3] += np.where(known[:, :, None] & known[:, None, :], more, 0.0)
    return out
