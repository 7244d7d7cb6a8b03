"""A new frame enters the window: its pose, the observations that agree with it, new landmarks.

Its pose is the predicted one if its observations agree with that; otherwise it is found from the landmarks.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from polhode.backend.initialization.initialize import ransac_orientation
from polhode.backend.problem.iterate import COM, POSITION, RATE, VELOCITY
from polhode.backend.window.estimator_state import EstimatorState
from polhode.backend.window.frame import Frame, FrameMeasurements
from polhode.geometry.camera import RectifiedRig, stereo_jacobian
from polhode.geometry.lie import (
    Array,
    Bools,
    Ints,
    exp_so3,
    hat,
    inverse_pose,
    log_so3,
    make_pose,
    transform_points,
)

MIN_FRAMES_FOR_DYNAMICS = 4
"""Number of located frames from which the dynamics predict better than a difference of poses."""
MAX_ATTITUDE_SIGMA_RAD = 0.1
"""Largest standard deviation of a predicted attitude by which new landmarks are placed."""
STEREO_GATE = 5.0
"""Largest norm of a residual, whitened by its noise and that of the landmark, of an accepted observation."""
MIN_AGREEING_SHARE = 0.6
"""Share of the observations of known landmarks that must agree with a pose."""
MIN_COMMON_LANDMARKS = 5


@dataclass(frozen=True)
class KnownLandmarks:
    """Observations of landmarks whose position is known."""

    uvd_px: Array
    """(m, 3)"""
    inv_sigma: Array
    """(m, 3)"""
    p_G: Array
    """(m, 3)"""
    covariance: Array
    """(m, 3, 3)"""

    def select(self, chosen: Bools) -> "KnownLandmarks":
        """Some of them."""
        return KnownLandmarks(*(each[chosen] for each in vars(self).values()))


class LocatedFrame(NamedTuple):
    """Pose (4, 4) of a frame, which (m,) observations of known landmarks agree, and how it was located."""

    X_RG: Array
    agree: Bools
    by: Literal["prediction", "map", "nothing"]


def first_frame(state: EstimatorState, m: FrameMeasurements, number: int, time_s: float) -> Frame:
    """The frame that defines G, with the axes of N and the median of the triangulated points as origin."""
    p_R = state.rig.triangulate(m.uvd_px)
    R_NG, p_NG = m.X_NR[:3, :3], (m.X_NR @ np.append(np.median(p_R, axis=0), 1.0))[:3]
    x = np.concatenate([p_NG, np.zeros(9)])
    frame = state.frame(m, number, time_s, R_NG, x)
    frame.fix_linearization()
    _set_observations(state, frame, m, np.ones(len(m.landmark), bool))
    return frame


def next_frame(state: EstimatorState, m: FrameMeasurements, number: int, time_s: float) -> Frame | None:
    """The frame with its initial state and accepted observations; None if it cannot be located."""
    before = state.active.recent[-1]
    n_located = len(state.active.frames)
    slot, index, known = known_landmarks(state, m)
    x, R_NG = state.predict(time_s)
    guess = inverse_pose(m.X_NR) @ make_pose(R_NG, x[POSITION]) if n_located >= 2 else None
    found = locate(state.rig, known, guess, number)
    is_lost = found.by == "nothing"
    if is_lost and n_located < MIN_FRAMES_FOR_DYNAMICS:
        return None
    if not is_lost:
        X_NG = m.X_NR @ found.X_RG
        R_NG, x[POSITION] = X_NG[:3, :3], X_NG[:3, 3]
        if n_located < MIN_FRAMES_FOR_DYNAMICS:
            # velocities by the difference of two poses, after the first two frames of both
            com_G, dt_s = state.active.constants[COM], time_s - before.time_s
            shift = x[POSITION] + R_NG @ com_G - before.x[POSITION] - before.R_NG @ com_G
            x[VELOCITY], x[RATE] = shift / dt_s, log_so3(before.R_NG.T @ R_NG) / dt_s
            if n_located == 1:
                before.x[VELOCITY], before.x[RATE] = x[VELOCITY], x[RATE]
    frame = state.frame(m, number, time_s, R_NG, x)
    contradicts = len(index) >= MIN_COMMON_LANDMARKS
    if is_lost and (contradicts or state.predicted_sigma(time_s) > MAX_ATTITUDE_SIGMA_RAD):
        # it contradicts the map, or its pose is unknown: its observations would only do harm
        return frame
    _set_observations(state, frame, m, _accepted(state, slot, index, found))
    return frame


def known_landmarks(state: EstimatorState, m: FrameMeasurements) -> tuple[Ints, Ints, KnownLandmarks]:
    """Slots (m,) of what a frame observes, -1: not known; the numbers of the known ones, and themselves."""
    slot = state.landmarks.find(m.landmark)
    index = np.flatnonzero(slot >= 0)
    inv_sigma = 1.0 / (m.sigma_px * state.noise)
    marks, at = state.landmarks, slot[index]
    known = KnownLandmarks(m.uvd_px[index], inv_sigma[index], marks.p_G[at], marks.covariance[at])
    return slot, index, known


def pose_in_map(state: EstimatorState, m: FrameMeasurements, number: int) -> tuple[Array, Array] | None:
    """X_RG (4, 4) from known landmarks alone, and its covariance (6, 6): shift and turn along the axes of G.

    None: too few observations agree with one pose.
    """
    _, _, known = known_landmarks(state, m)
    found = locate(state.rig, known, None, number)
    if found.by == "nothing":
        return None
    H, _ = pose_equations(state.rig, known.select(found.agree), found.X_RG)
    return found.X_RG, np.asarray(np.linalg.inv(H))


def _accepted(state: EstimatorState, slot: Ints, index: Ints, found: LocatedFrame) -> Bools:
    """Accepted observations (m,): those of new landmarks, and those of known ones that agree."""
    marks, enter = state.landmarks, np.ones(len(slot), bool)
    agreeing, other = slot[index[found.agree]], index[~found.agree]
    marks.refused[agreeing] = 0
    marks.refused[slot[other]] += 1
    wrong = (marks.refused[slot[other]] >= 2) | (marks.views[slot[other]] <= 1)
    enter[other] = wrong
    restart = slot[other[wrong]]
    if len(restart) == 0:
        return enter
    restarted = np.zeros(len(marks), bool)
    restarted[restart] = True
    for frame in state.active.frames:
        stays: Bools = ~restarted[frame.slot]
        if not stays.all():
            marks.leave(frame.slot[~stays])
            frame.keep(stays)
    return enter


def _set_observations(state: EstimatorState, frame: Frame, m: FrameMeasurements, enter: Bools) -> None:
    """Give the frame its observations; place new landmarks by its pose."""
    marks, names = state.landmarks, m.landmark[enter]
    uvd, inv_sigma = m.uvd_px[enter], 1.0 / (m.sigma_px[enter] * state.noise)
    slot = marks.find(names)
    new = slot < 0
    slot[new] = marks.take(names[new])
    X_GR = inverse_pose(frame.X_NG_seen) @ m.X_NR
    p_R = state.rig.triangulate(uvd[new])
    marks.p_G[slot[new]] = transform_points(X_GR, p_R)
    spread = X_GR[:3, :3] @ state.rig.triangulation_jacobian(p_R) / inv_sigma[new][:, None, :]
    marks.covariance[slot[new]] = spread @ np.swapaxes(spread, 1, 2)
    marks.views[slot] += 1
    order = np.argsort(slot)
    frame.slot, frame.uvd_px, frame.inv_sigma = slot[order], uvd[order], inv_sigma[order]


def locate(rig: RectifiedRig, known: KnownLandmarks, guess: Array | None, seed: int) -> LocatedFrame:
    """Pose X_RG from a guess (None: there is none) and the observations of known landmarks."""
    m = len(known.p_G)
    enough = max(MIN_COMMON_LANDMARKS, MIN_AGREEING_SHARE * m)
    if guess is not None:
        X, agree = guess, agreement(rig, known, guess)
        if max(MIN_COMMON_LANDMARKS, 0.3 * m) <= agree.sum() < enough:
            X, agree = refine(rig, known, X, agree)
        if agree.sum() >= enough:
            return LocatedFrame(X, agree, "prediction")
    if m >= MIN_COMMON_LANDMARKS:
        p_R = rig.triangulate(known.uvd_px)
        spread = rig.triangulation_jacobian(p_R) @ (1.0 / known.inv_sigma)[:, :, None]
        own = np.sum(spread[..., 0] ** 2, axis=1)
        gate_m = 4.0 * np.sqrt(own + np.trace(known.covariance, axis1=1, axis2=2))
        X, _ = ransac_orientation(p_R, known.p_G, gate_m, np.random.default_rng([seed, m]))
        X, agree = refine(rig, known, X, agreement(rig, known, X))
        # less than for a prediction: 30 % gross errors, and some landmarks are wrong
        if agree.sum() >= max(MIN_COMMON_LANDMARKS, 0.4 * m):
            return LocatedFrame(X, agree, "map")
    if guess is None:
        return LocatedFrame(np.eye(4), np.zeros(m, bool), "nothing")
    return LocatedFrame(guess, agreement(rig, known, guess), "nothing")


def agreement(rig: RectifiedRig, known: KnownLandmarks, X_RG: Array) -> Bools:
    """(m,) which observations lie within ``STEREO_GATE``."""
    r, J = whitened(rig, known, X_RG)
    spread = np.eye(3) + J @ known.covariance @ np.swapaxes(J, 1, 2)
    squared = np.einsum("mi,mi->m", r, np.linalg.solve(spread, r[..., None])[..., 0])
    return np.asarray(squared < STEREO_GATE**2)


def whitened(rig: RectifiedRig, known: KnownLandmarks, X_RG: Array) -> tuple[Array, Array]:
    """Residuals (m, 3) over their sigma, and their derivative (m, 3, 3) in the landmark's position in G."""
    R, p = X_RG[:3, :3], X_RG[:3, 3]
    p_R = known.p_G @ R.T + p
    # points behind the camera do not agree
    p_R[:, 2] = np.maximum(p_R[:, 2], 1e-3)
    D = -stereo_jacobian(p_R, rig.focal_px, rig.baseline_m)
    r = (known.uvd_px - rig.project(p_R)) * known.inv_sigma
    return r, known.inv_sigma[:, :, None] * (D @ R)


def refine(rig: RectifiedRig, known: KnownLandmarks, X_RG: Array, agree: Bools) -> tuple[Array, Bools]:
    """Least-squares pose from the observations that agree, which are selected again in each iteration."""
    X = X_RG.copy()
    for _ in range(3):
        if agree.sum() < MIN_COMMON_LANDMARKS:
            return X, agree
        H, g = pose_equations(rig, known.select(agree), X)
        step = -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(6), g)
        X[:3, 3] = X[:3, 3] + X[:3, :3] @ step[:3]
        X[:3, :3] = X[:3, :3] @ exp_so3(step[3:])
        agree = agreement(rig, known, X)
    return X, agree


def pose_equations(rig: RectifiedRig, known: KnownLandmarks, X_RG: Array) -> tuple[Array, Array]:
    """Information (6, 6) on X_RG Exp(shift, theta), and the gradient (6,)."""
    r, J = whitened(rig, known, X_RG)
    # the landmark moves by shift - p_G x theta
    J6 = np.concatenate([J, -J @ hat(known.p_G)], axis=2)
    W = np.linalg.inv(np.eye(3) + J @ known.covariance @ np.swapaxes(J, 1, 2))
    return np.einsum("mia,mij,mjb->ab", J6, W, J6), np.einsum("mia,mij,mj->a", J6, W, r)
