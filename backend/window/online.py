"""The sliding window over a whole sequence: the causal estimate at each frame."""

import logging
from dataclasses import replace
from time import perf_counter

import numpy as np
from scipy.spatial.transform import Rotation

from polhode.backend.noise.systematic import online_with_systematic
from polhode.backend.window.causal_state import OnlineState
from polhode.backend.window.estimator import SlidingWindow
from polhode.backend.window.frame import camera_noise_of, frames_of
from polhode.config.backend import Backend
from polhode.lie import Array, inverse_pose, transform_points
from polhode.progress import Progress
from polhode.records import MotionEstimate, OnlineEstimate, StereoTracks
from polhode.rigid_body import HALF_TURNS
from polhode.threads import single_threaded

ALIGNED_FRAMES = 10
"""Number of last frames by whose poses the causal frame G is aligned with the final one."""

_log = logging.getLogger(__name__)


@single_threaded
def estimate_online(tracks: StereoTracks, config: Backend, progress: Progress) -> OnlineEstimate:
    """Process the frames in the order of time. A row depends only on its frame and earlier ones."""
    window = SlidingWindow(tracks.rig, config, camera_noise_of(tracks))
    states, seconds = [], []
    with progress.stage("sliding window", tracks.n_frames) as advance:
        for measurements in frames_of(tracks):
            begin = perf_counter()
            states.append(window.add(measurements))
            seconds.append(perf_counter() - begin)
            advance()
    _log.info("window: median %.0f ms a frame, %.1f s in all", 1e3 * np.median(seconds), sum(seconds))
    return online_with_systematic(stack_states(states), tracks, config.systematic_px)


def window_warnings(n_frames: int, config: Backend) -> list[str]:
    """Warnings about settings that do not suit the sequence, one line each."""
    window = config.window
    if not window.enabled or window.frames <= n_frames:
        return []
    return [
        f"backend.window.frames: the sliding window of {window.frames} frames is longer than the sequence of "
        f"{n_frames}; the causal estimate smooths all frames so far"
    ]


def stack_states(states: list[OnlineState]) -> OnlineEstimate:
    """One record of the states of all frames."""
    return OnlineEstimate(
        timestamps_ns=np.array([s.timestamp_ns for s in states], dtype=np.int64),
        r_N=np.stack([s.r_N for s in states]),
        v_N=np.stack([s.v_N for s in states]),
        R_NP=np.stack([s.R_NP for s in states]),
        w_P=np.stack([s.w_P for s in states]),
        covariance=np.stack([s.covariance for s in states]),
        X_NG=np.stack([s.X_NG for s in states]),
        k=np.array([[s.k1, s.k2] for s in states]),
        cov_k=np.stack([s.cov_k for s in states]),
        com_G=np.stack([s.com_G for s in states]),
        cov_com_G=np.stack([s.cov_com_G for s in states]),
        R_GP=np.stack([s.R_GP for s in states]),
        cov_R_GP=np.stack([s.cov_R_GP for s in states]),
        determined=np.stack([s.determined for s in states]),
    )


def align_online_estimate(online: OnlineEstimate, final: MotionEstimate) -> OnlineEstimate:
    """Express the causal estimate in the frame G and with the half-turns of the final one.

    This changes conventions only and adds no information. Each row takes the half-turn of the axes that is
    nearest to the final attitude at its frame. The two frames G differ by a constant: the mean over the last
    frames is taken.
    """
    last = slice(-ALIGNED_FRAMES, None)
    X = inverse_pose(final.X_NG[last]) @ online.X_NG[last]
    R = Rotation.from_matrix(X[:, :3, :3]).mean().as_matrix()
    X_FG = np.eye(4)
    X_FG[:3, :3], X_FG[:3, 3] = R, np.median(X[:, :3, 3], axis=0)
    along = np.einsum("fij,fij->fj", online.R_NP, final.R_NP)
    turn: Array = HALF_TURNS[np.argmax(along @ HALF_TURNS.T, axis=1)]
    sign = np.concatenate([np.ones((len(turn), 6)), turn, turn], axis=1)
    return replace(
        online,
        R_NP=online.R_NP * turn[:, None, :],
        w_P=online.w_P * turn,
        covariance=online.covariance * sign[:, :, None] * sign[:, None, :],
        X_NG=online.X_NG @ inverse_pose(X_FG),
        com_G=transform_points(X_FG, online.com_G),
        cov_com_G=_turned(online.cov_com_G, R),
        R_GP=R @ online.R_GP * turn[:, None, :],
        cov_R_GP=online.cov_R_GP * turn[:, :, None] * turn[:, None, :],
    )


def _turned(covariance: Array, R: Array) -> Array:
    """Covariances (F, 3, 3) in other axes; components that involve an undetermined one are undetermined."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    lost = ~np.isfinite(variance)
    finite = np.where(lost[:, :, None] | lost[:, None, :], 0.0, covariance)
    out = R @ finite @ R.T
    touched = (np.abs(R)[None] * lost[:, None, :]).max(axis=2) > 0.1
    out[touched[:, :, None] | touched[:, None, :]] = 0.0
    rows, components = np.nonzero(touched)
    out[rows, components, components] = np.inf
    return np.asarray(out)
