"""Errors that all landmarks share: no residual shows them, and no solver's covariance includes them.

A matcher that reads every disparity slightly too small shifts the whole target. The effect of such an offset
of u, v and disparity on a point at the target's position is added to the covariance of the position;
attitude, rates and inertia are hardly affected. The frame G is fixed where the first pose was seen, not where
it was: the centre of mass in G is off by the same shift.

Errors of the calibration move the solution of all frames as ``uncertainty/calibration_response.py`` has it.
The causal estimate has no such solution: there the field of shifts of a point about the target's place moves
the state: its value the position, its rotation the attitude, and their changes since the motion was first
known, over which free motion averages, velocity and rate. Inertia and axes lack their part.

The points that features mark on a shaded surface slide along it with the light. The Sun moves all of them
alike, in a direction that is fixed in N, while the body turns: this looks like a shift of the target, and, as
other sides of it come into view, like changes of its attitude (``common_slide``).
"""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.uncertainty.identifiability import with_more
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, hat, inverse_pose, log_so3, transform_points
from polhode.records.calibration_effects import CalibrationEffects
from polhode.records.estimate import Identifiability, MassProperties, MotionEstimate, OnlineEstimate
from polhode.records.tracks import StereoTracks


@dataclass(frozen=True)
class SharedErrors:
    """Standard deviations of the errors that all frames share."""

    offset_px: tuple[float, float, float]
    """of u, v, disparity"""
    slide_px: float = 0.0
    """of a slide along each axis of N, in the image"""


def common_slide(fit: MotionFit, to_landmark: Array, sigma_px: float) -> Array:
    """Effect (M, 3, 3) on the whitened observations of slides of all landmarks along the three axes of N.

    Each by sigma_px, seen from the median distance. Landmarks slide along the surface, whose normal is taken
    to be the direction from their middle. to_landmark (M, 3, 3): derivatives of the whitened residuals.
    """
    data, iterate = fit.data, fit.iterate
    distance_m = np.linalg.norm(iterate.p_NG - data.camera_N, axis=1)
    sigma_m = sigma_px * float(np.median(distance_m)) / data.rig[0]
    outward = iterate.p_G - np.median(iterate.p_G, axis=0)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    normal, axes = outward[data.landmark], np.swapaxes(iterate.R_NG, 1, 2)[data.frame]
    along = axes - normal[:, :, None] * np.einsum("mi,mij->mj", normal, axes)[:, None]
    return np.asarray(sigma_m * to_landmark @ along)


def position_spread(rig: RectifiedRig, X_NR: Array, r_N: Array, shared: SharedErrors) -> Array:
    """Shifts (F, 3, 6) in N [m] of positions r_N (F, 3) for one sigma of each error; X_NR (F, 4, 4).

    Three offsets of u, v and disparity, three slides along the axes of N.
    """
    r_R = transform_points(inverse_pose(X_NR), r_N[:, None])[:, 0]
    offsets = X_NR[:, :3, :3] @ rig.triangulation_jacobian(r_R) * np.asarray(shared.offset_px)
    slide_m = shared.slide_px * r_R[:, 2] / rig.focal_px
    return np.concatenate([offsets, slide_m[:, None, None] * np.eye(3)], axis=2)


def calibration_spread(
    rig: RectifiedRig, effects: CalibrationEffects, X_NR: Array, online: OnlineEstimate, first: int
) -> Array:
    """Errors (F, 12, 2 c) of the states for one sigma of each error of the calibration; first: known row.

    The second half of the columns is what the strain of the field turns: a part of the body that faces the
    camera as a plane turns with it, a whole body does not, and what is seen lies between.
    """
    R_RN = np.swapaxes(X_NR[:, :3, :3], 1, 2)
    r_R = transform_points(inverse_pose(X_NR), online.r_N[:, None])[:, 0]
    # of the camera since the row before
    dt_s = np.maximum(1e-9 * np.diff(online.timestamps_ns), 1e-9)[:, None]
    turning_R, moving_N = np.zeros((2, len(X_NR), 3))
    turning_R[1:] = log_so3(R_RN[:-1] @ X_NR[1:, :3, :3]) / dt_s
    moving_N[1:] = np.diff(X_NR[:, :3, 3], axis=0) / dt_s
    v_R = np.einsum("fij,fj->fi", R_RN, online.v_N - moving_N) - np.cross(turning_R, r_R)

    def shift(p_R: Array) -> Array:
        return rig.triangulation_jacobian(p_R) @ effects.at(rig, p_R, v_R)

    at = shift(r_R)
    step = 1e-3 * r_R[:, 2, None] * np.eye(3)[:, None]
    # (F, 3, 3, c): change along the second axis
    slope = np.stack([shift(r_R + e) - shift(r_R - e) for e in step], axis=2)
    slope /= 2e-3 * r_R[:, 2, None, None, None]
    pairs = ((2, 1), (0, 2), (1, 0))
    turn = 0.5 * np.stack([slope[:, a, b] - slope[:, b, a] for a, b in pairs], axis=1)
    strain = [0.5 * (slope[:, a, b] + slope[:, b, a]) for a, b in pairs[:2]]
    wobble = np.stack([strain[0], -strain[1], np.zeros_like(strain[0])], axis=1)
    # shifts and turns (F, 3, 2 c) in N
    moved = X_NR[:, :3, :3] @ np.concatenate([at, np.zeros_like(at)], axis=2)
    turned = X_NR[:, :3, :3] @ np.concatenate([turn, wobble], axis=2)
    since_s = np.maximum(1e-9 * (online.timestamps_ns - online.timestamps_ns[first]), 1e-9)[:, None, None]
    R_PN = np.swapaxes(online.R_NP, 1, 2)
    rates = R_PN @ (turned - turned[first]) / since_s
    return np.concatenate([moved, (moved - moved[first]) / since_s, R_PN @ turned, rates], axis=1)


def with_systematic(estimate: MotionEstimate, tracks: StereoTracks, shared: SharedErrors) -> MotionEstimate:
    """The estimate with offsets of all frames in the covariances of its positions and centre of mass."""
    spread = position_spread(tracks.rig, tracks.X_NR, estimate.r_N, shared)
    in_G = estimate.X_NG[0, :3, :3].T @ spread[0]
    joint = np.zeros((20, in_G.shape[1]))
    joint[:3], joint[17:] = spread[-1], in_G
    body, marks, mass = estimate.covariance_last_body, estimate.covariance_of_marks, estimate.mass
    return replace(
        estimate,
        covariance=_inflated_each(estimate.covariance, spread),
        covariance_last_joint=_inflated(estimate.covariance_last_joint, joint),
        covariance_last_body=None if body is None else _inflated(body, joint),
        covariance_of_marks=(
            None if marks is None else _inflated_each(marks, _of_marks(estimate, spread, in_G))
        ),
        mass=replace(
            mass, cov_com_G=_inflated(mass.cov_com_G, in_G), identifiable=_inflated_verdict(mass, in_G)
        ),
    )


def _of_marks(estimate: MotionEstimate, spread: Array, in_G: Array) -> Array:
    """Errors (F, 6, n) of position and velocity of the mark where the centre of mass is estimated."""
    lever = estimate.R_NP @ (estimate.mass.R_GP.T @ in_G)
    w_N = (estimate.R_NP @ estimate.w_P[:, :, None])[:, :, 0]
    return np.concatenate([spread - lever, -hat(w_N) @ lever], axis=1)


def _inflated_verdict(mass: MassProperties, in_G: Array) -> Identifiability:
    """Identifiability with errors in_G (3, n) of the centre of mass added."""
    return with_more(mass.identifiable, np.append(np.linalg.norm(mass.R_GP.T @ in_G, axis=1), np.zeros(5)))


def online_with_systematic(
    online: OnlineEstimate,
    rig: RectifiedRig,
    X_NR: Array,
    shared: SharedErrors,
    calibration: CalibrationEffects | None = None,
) -> OnlineEstimate:
    """The causal estimate with systematic errors in the covariances of states and centre of mass.

    X_NR (F, 4, 4): poses of the rectified left camera. A row depends on itself, the one before
    and the first known one only.
    """
    spread, in_G = _online_spread(online, rig, X_NR, shared, calibration)
    return replace(
        online,
        covariance=_inflated_each(online.covariance, spread),
        cov_com_G=np.stack([_inflated(c, in_G) for c in online.cov_com_G]),
    )


def body_with_systematic(
    covariance: Array,
    online: OnlineEstimate,
    rig: RectifiedRig,
    X_NR: Array,
    shared: SharedErrors,
    calibration: CalibrationEffects | None = None,
) -> Array:
    """Covariance (20, 20) of the body itself at the last row of the causal estimate, with the same errors."""
    spread, in_G = _online_spread(online, rig, X_NR, shared, calibration)
    joint = np.zeros((20, in_G.shape[1]))
    joint[: spread.shape[1]], joint[17:] = spread[-1], in_G
    # attitude and rate along G
    for rows in (slice(6, 9), slice(9, 12)):
        joint[rows] = online.R_GP[-1] @ joint[rows]
    return _inflated(covariance, joint)


def _online_spread(
    online: OnlineEstimate,
    rig: RectifiedRig,
    X_NR: Array,
    shared: SharedErrors,
    calibration: CalibrationEffects | None,
) -> tuple[Array, Array]:
    """Errors of the states (F, 3 or 12, n), and of the centre of mass in G (3, n)."""
    spread = position_spread(rig, X_NR, online.r_N, shared)
    known = np.isfinite(np.diagonal(online.covariance, axis1=1, axis2=2)).any(axis=1)
    first = int(np.argmax(known))
    if calibration is not None:
        more = calibration_spread(rig, calibration, X_NR, online, first)
        wide = np.zeros((len(spread), 12, spread.shape[2] + more.shape[2]))
        wide[:, :3, : spread.shape[2]], wide[:, :, spread.shape[2] :] = spread, more
        spread = wide
    return spread, online.X_NG[first, :3, :3].T @ spread[first, :3]


def _inflated_each(covariances: Array, spreads: Array) -> Array:
    return np.stack([_inflated(c, s) for c, s in zip(covariances, spreads, strict=True)])


def _inflated(covariance: Array, spread: Array) -> Array:
    """Covariance (n, n) with errors spread (m, n) of its first m components added; infinite ones stay so."""
    m = len(spread)
    spread = spread * np.isfinite(np.diagonal(covariance)[:m, None])
    out = covariance.copy()
    out[:m, :m] += spread @ spread.T
    return out
