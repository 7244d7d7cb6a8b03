"""Whether time stamps, the inspector's poses and landmarks agree with the motion of the target.

- The clock. Between two frames the target turns by an angle that the poses show, whatever the clock. At the
  rates before and after it, the turn takes a time; where that is not the time between the stamps, the clock
  has jumped, or frames bear stamps of others.
- The inspector. The images show the target in the camera; the reported poses carry it into N, where it moves
  smoothly. If the rotation is rougher in N than it is in the camera, the poses add the roughness: they are
  wrong by more than they state.
- A slow swing of the inspector takes many frames. It displaces the target across the line of sight and turns
  it, at once and in the ratio that its distance prescribes; no force and torque do this
  (``backend/outliers_and_noise/inspector_swing.py``). It shows also where the inspector claims to be at rest.
- Landmarks. Where hardly one is seen on both sides of an instant, what is common to both parts, the centre of
  mass, the axes and the turn between them, rests on the motion that was predicted across. A wrong prediction,
  by a wrong inertia or a fraction of a turn, fits each part, and no residual shows it.
"""

import numpy as np

from polhode.backend.outliers_and_noise.inspector_swing import find_swing
from polhode.backend.subset_solution import solved_again
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Bools, inverse_pose, log_so3
from polhode.records.estimate import MotionEstimate
from polhode.records.metrics import angle_deg
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.check_table import CHECK_TABLE, frame_step, make_check
from polhode.run_directory.summary_schema import Check

ROUGHNESS_PER_SIGMA = float(np.sqrt(15.0))
"""Root mean square of the roughness over the standard deviation of a pose's attitude about each axis: the
coefficients of four successive poses are -1/2, 3/2, -3/2, 1/2."""
MIN_FRAMES = 2
"""With observations, on either side of an instant: a single frame contributes little."""
AGREES_DEG = 5.0
"""Below it, few inliers on one side of the body explain the difference of a link from the motion."""
MIN_SWING_DEG = 0.1
"""Oscillation of the inspector's attitude that matters; wrong runs have 0.14 and more."""


def _turns(R: Array) -> Array:
    """(F - 1, 3) rotation vectors from each attitude (F, 3, 3) to the next, in the frame that stays [rad]."""
    return log_so3(R[1:] @ np.swapaxes(R[:-1], 1, 2))


def clock_check(time_s: Array, R_NG: Array, seen: Bools) -> Check:
    """Whether the stamps agree with the rotation.

    time_s (F,) [s], R_NG (F, 3, 3), seen (F,): with observations. Only steps between frames that are seen,
    with a seen frame before and one after, are judged. The error is over the longer of the stated and the
    usual interval.
    """
    stated, needed = np.diff(time_s), needed_s(time_s, R_NG, seen)
    if not np.isfinite(needed).any():
        return make_check("clock", None)
    error_s = np.abs(needed - stated)
    relative = error_s / np.maximum(stated, np.median(stated))
    limit = 0.01 * (CHECK_TABLE["clock"].limit or 0.0)
    worst = int(np.argmax(np.where(relative > limit, error_s, 0.0)))
    facts = {"from_s": time_s[worst], "stated_s": stated[worst], "needed_s": needed[worst]}
    return make_check("clock", 100.0 * float(np.nanmax(relative)), **facts)


def needed_s(time_s: Array, R_NG: Array, seen: Bools) -> Array:
    """(F - 1,) time of each step at the mean of the rates before and after it [s]; NaN: not judged."""
    turns, dt_s = _turns(R_NG), np.diff(time_s)
    rates = turns / dt_s[:, None]
    whole = seen[:-1] & seen[1:]
    out = np.full(len(dt_s), np.nan)
    for k in range(1, len(dt_s) - 1):
        if not whole[k - 1 : k + 2].all():
            continue
        before, after, turn = rates[k - 1], rates[k + 1], turns[k]
        rate = 0.5 * (before + after)
        speed, angle = float(np.linalg.norm(rate)), float(np.linalg.norm(turn))
        longest = max(angle, speed * dt_s[k], float(np.linalg.norm(turns[[k - 1, k + 1]], axis=1).max()))
        # over a longer turn, the rates before and after it say little
        if longest > np.deg2rad(120.0) or angle < np.deg2rad(3.0):
            continue
        along = float(turn @ rate) / speed**2
        # where the rates differ, a step beside this one is the odd one; with another axis, it is another turn
        fastest = max(np.linalg.norm(before), np.linalg.norm(after))
        steady = np.linalg.norm(before - after) < 0.2 * fastest
        if steady and np.linalg.norm(turn - along * rate) < 0.15 * angle:
            out[k] = along
    return out


def inspector_check(X_NR: Array, X_NG: Array, seen: Bools, sigma_theta_rad: float) -> Check:
    """Whether the reported poses agree with the images; not possible for a camera that stays at one pose.

    X_NR (F, 4, 4): camera as reported; X_NG (F, 4, 4): target by these; seen (F,): with observations. Right
    poses of a camera that moves make the roughness smaller, so twice that in the camera is clear, and four
    times that of the stated standard deviation.
    """
    if np.ptp(X_NR, axis=0).max() == 0.0:
        return make_check("inspector attitude", None)
    X_RG = inverse_pose(X_NR) @ X_NG
    in_N, in_camera = roughness(X_NG[:, :3, :3], seen), roughness(X_RG[:, :3, :3], seen)
    if min(len(in_N), len(in_camera)) < 8:
        return make_check("inspector attitude", None)
    error_deg, camera_deg = (
        float(np.rad2deg(np.sqrt(np.mean(each**2)))) / ROUGHNESS_PER_SIGMA for each in (in_N, in_camera)
    )
    stated_deg = float(np.rad2deg(sigma_theta_rad))
    limit = max(CHECK_TABLE["inspector attitude"].limit or 0.0, 2.0 * camera_deg, 4.0 * stated_deg)
    return make_check("inspector attitude", error_deg, limit, stated_deg=stated_deg)


def roughness(R: Array, seen: Bools) -> Array:
    """(n,) length of each turn of R (F, 3, 3) less the mean of its neighbours [rad], where four frames are
    seen."""
    turns = _turns(R)
    whole = seen[:-3] & seen[1:-2] & seen[2:-1] & seen[3:]
    return np.asarray(np.linalg.norm(turns[1:-1] - 0.5 * (turns[:-2] + turns[2:]), axis=1)[whole])


def swing_check(tracks: StereoTracks, estimate: MotionEstimate, config: Backend) -> Check:
    """How much better a swing explains the motion than forces and torques do; not possible with few data."""
    frames = np.arange(0, tracks.n_frames, frame_step(tracks.n_frames))
    solution = solved_again(tracks, estimate, config, frames)
    swing = None if solution is None else find_swing(solution)
    if swing is None:
        return make_check("inspector swing", None)
    swing_deg = float(np.rad2deg(swing.rms_rad))
    # a smaller one, however evident, is of the size that the calibration pretends
    gain = swing.evidence_gain if swing_deg > MIN_SWING_DEG else 0.0
    return make_check("inspector swing", max(gain, 0.0), swing_deg=swing_deg)


def connection_check(
    tracks: StereoTracks, estimate: MotionEstimate, links: RelativePoses | None = None
) -> Check:
    """Whether landmarks connect all parts of the sequence, or matches of two frames that agree with it."""
    good = estimate.inlier_weight > 0.1
    frame, landmark = tracks.frame[good], tracks.landmark[good]
    seen = np.unique(frame)
    if len(seen) < 2 * MIN_FRAMES:
        return make_check("connection", None)
    first = np.full(tracks.n_landmarks, tracks.n_frames)
    last = np.full(tracks.n_landmarks, -1)
    np.minimum.at(first, landmark, frame)
    np.maximum.at(last, landmark, frame)
    places = seen[MIN_FRAMES - 1 : len(seen) - MIN_FRAMES]
    shared = np.array([int(np.sum((first <= k) & (last > k))) for k in places])
    if links is not None:
        inliers = np.where(
            contradicted_deg(links, inverse_pose(tracks.X_NR) @ estimate.X_NG) < AGREES_DEG, links.inliers, 0
        )
        across = [inliers[(links.i <= k) & (links.j > k)].max(initial=0) for k in places]
        shared = np.maximum(shared, across)
    n, weak = int(np.argmin(shared)), int(np.sum(shared < (CHECK_TABLE["connection"].limit or 0.0)))
    start_s, end_s = (tracks.time_s[k] for k in (places[n], seen[MIN_FRAMES + n]))
    count = f"{shared[n] or 'no'} landmark{'' if shared[n] == 1 else 's'}"
    others = f" (the weakest of {weak} such places)" if weak > 1 else ""
    return make_check("connection", shared[n], start_s=start_s, end_s=end_s, count=count, others=others)


def contradicted_deg(links: RelativePoses, X_RG: Array) -> Array:
    """Angles (n,) between links and the motion; X_RG (F, 4, 4): the target in the camera, as found."""
    moved = X_RG[links.i] @ inverse_pose(X_RG[links.j])
    return angle_deg(np.swapaxes(moved[:, :3, :3], 1, 2) @ links.X_RiRj[:, :3, :3])
