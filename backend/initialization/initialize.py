"""An initial motion without any guess: pose graph, bundle adjustment, interpolation over other frames."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from polhode.backend.initialization.pose_graph import connect
from polhode.backend.initialization.rates import FAST_HINT, interval_rates, jumping_frames
from polhode.backend.problem.inertia import FORMS
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import linearization_point
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import (
    Array,
    Bools,
    Ints,
    exp_so3,
    inverse_pose,
    log_so3,
    make_pose,
    transform_points,
)
from polhode.geometry.rigid_fit import fit_rigid
from polhode.records.estimate import InitialMotion
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.runtime.errors import RunFailure
from polhode.runtime.threads import single_threaded

MIN_CONNECTED = 3
MIN_COMMON = 4
"""Landmarks that a frame must share with the map to be located in it."""
MIN_AGREEMENT = 0.4
"""Share of a frame's observations that must agree with the map; with less its pose is wrong."""
MIN_CONSISTENT = 0.1
"""The same before bundle adjustment, when correct poses may still be off by some degrees."""
BUNDLE_ITERATIONS = 12


@single_threaded
def initialize_motion(tracks: StereoTracks, relative: RelativePoses, config: Backend) -> InitialMotion:
    """Poses of the target from relative poses and tracks, G's origin in the middle of its landmarks.

    Raises RunFailure if fewer than three frames can be connected.
    """
    X_RG, connected, _ = connect(relative, tracks.time_s, tracks.X_NR[:, :3, :3])
    if connected.sum() < MIN_CONNECTED:
        raise RunFailure(
            f"no consistent motion: only {connected.sum()} of {tracks.n_frames} frames could be connected"
        )
    p_G, known = robust_landmarks(tracks, X_RG, connected)
    # Bundle adjustment would carry a frame whose landmarks are all elsewhere far away from the target, and
    # landmarks with it; where it then ends is decided by rounding.
    consistent = connected & (agreement(tracks, X_RG, p_G) >= MIN_CONSISTENT)
    if consistent.sum() >= MIN_CONNECTED and not np.array_equal(consistent, connected):
        connected = consistent
        p_G, known = robust_landmarks(tracks, X_RG, connected)
    X_RG, connected = relocalize(tracks, X_RG, connected, p_G, known)
    X_RG = bundle_adjust(tracks, X_RG, connected, config)
    p_G, known = robust_landmarks(tracks, X_RG, connected)
    agree = connected & (agreement(tracks, X_RG, p_G) >= MIN_AGREEMENT)
    if agree.sum() >= MIN_CONNECTED and not np.array_equal(agree, connected):
        p_G, known = robust_landmarks(tracks, X_RG, agree)
        X_RG, connected = relocalize(tracks, X_RG, agree, p_G, known)
        X_RG = bundle_adjust(tracks, X_RG, connected, config)
        p_G, known = robust_landmarks(tracks, X_RG, connected)
    X_RG, connected = relocalize(tracks, X_RG, connected, p_G, known)
    odd = jumping_frames(tracks.time_s, (tracks.X_NR @ X_RG)[:, :3, :3], connected)
    connected = connected & ~odd
    if connected.sum() < MIN_CONNECTED:
        raise RunFailure(
            f"no consistent motion: only {connected.sum()} of {tracks.n_frames} frames agree with the map of "
            f"the landmarks ({FAST_HINT})"
        )
    X_RG[connected] = X_RG[connected] @ make_pose(np.eye(3), np.median(p_G[known], axis=0))
    X_NG = bridge(tracks.time_s, tracks.X_NR @ X_RG, connected)
    return InitialMotion(inverse_pose(tracks.X_NR) @ X_NG, connected)


def consistent_links(relative: RelativePoses, time_s: Array, R_NR: Array) -> Bools:
    """Which links (E,) the pose graph does not contradict; a track through a wrong link joins two points.

    time_s (F,) [s], R_NR (F, 3, 3) attitudes of the camera. Links of unconnected frames count as consistent.
    """
    _, connected, accepted = connect(relative, time_s, R_NR)
    return np.asarray(accepted | ~(connected[relative.i] & connected[relative.j]))


def robust_landmarks(tracks: StereoTracks, X_RG: Array, connected: Bools) -> tuple[Array, Bools]:
    """Landmarks (L, 3) in G, the componentwise median of their triangulations, and which are known (L,)."""
    n = tracks.n_landmarks
    use = np.flatnonzero(connected[tracks.frame])
    p_R = tracks.rig.triangulate(tracks.uvd_px[use])
    p = np.einsum("mba,mb->ma", X_RG[tracks.frame[use], :3, :3], p_R - X_RG[tracks.frame[use], :3, 3])
    mark = tracks.landmark[use]
    count = np.bincount(mark, minlength=n)
    known = count > 0
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    p_G = np.zeros((n, 3))
    for axis in range(3):
        ordered = p[np.lexsort((p[:, axis], mark)), axis]
        low, high = start + (count - 1) // 2, start + count // 2
        p_G[known, axis] = 0.5 * (ordered[low[known]] + ordered[high[known]])
    if known.any():
        p_G[~known] = np.median(p_G[known], axis=0)
    return p_G, known


def bundle_adjust(tracks: StereoTracks, X_RG: Array, connected: Bools, config: Backend) -> Array:
    """Refine the connected poses and the landmarks on the pixels, without dynamics."""
    kept = _observations_of(tracks, connected)
    data = motion_data(kept, config)
    p_G, _ = robust_landmarks(kept, X_RG, connected)
    X_NG = tracks.X_NR @ X_RG
    zero = np.zeros((tracks.n_frames, 3))
    xi, R_inertia = FORMS[config.inertia].coordinates(np.eye(3))
    start = Iterate(X_NG[:, :3, 3], X_NG[:, :3, :3], zero, zero, np.zeros(3), xi, R_inertia, p_G)
    fixed = linearization_point(data, start)
    solution = GaussNewton(data, with_dynamics=False).solve(fixed, start.vector(), BUNDLE_ITERATIONS)
    at = start.moved_to(solution.x)
    X_NG[connected] = make_pose(at.R_NG, at.p_NG)[connected]
    return np.asarray(inverse_pose(tracks.X_NR) @ X_NG)


def _observations_of(tracks: StereoTracks, frames: Bools) -> StereoTracks:
    use = frames[tracks.frame]
    _, landmark = np.unique(tracks.landmark[use], return_inverse=True)
    return replace(
        tracks,
        frame=tracks.frame[use],
        landmark=landmark.astype(np.int64),
        uvd_px=tracks.uvd_px[use],
        sigma_px=tracks.sigma_px[use],
    )


def relocalize(
    tracks: StereoTracks, X_RG: Array, connected: Bools, p_G: Array, known: Bools
) -> tuple[Array, Bools]:
    """Locate further frames by absolute orientation on landmarks that they share with the map."""
    X_RG, connected = X_RG.copy(), connected.copy()
    for k in np.flatnonzero(~connected):
        of_frame = np.flatnonzero((tracks.frame == k) & known[tracks.landmark])
        if len(of_frame) < MIN_COMMON:
            continue
        p_R, target = tracks.rig.triangulate(tracks.uvd_px[of_frame]), p_G[tracks.landmark[of_frame]]
        gate = triangulation_gate_m(tracks, of_frame, p_R)
        X, inliers = ransac_orientation(p_R, target, gate, np.random.default_rng(int(k)))
        if inliers >= max(MIN_COMMON, 0.5 * len(of_frame)):
            X_RG[k], connected[k] = X, True
    return X_RG, connected


def triangulation_gate_m(tracks: StereoTracks, use: Ints, p_R: Array) -> Array:
    """Largest error (n,) [m] of a correct triangulation p_R (n, 3) of the observations ``use``."""
    sigma = tracks.rig.triangulation_jacobian(p_R) @ tracks.sigma_px[use][:, :, None]
    return np.asarray(4.0 * np.linalg.norm(sigma[..., 0], axis=1))


def agreement(tracks: StereoTracks, X_RG: Array, p_G: Array) -> Array:
    """Share (F,) of each frame's observations that lie near their landmark; 0 without observations."""
    p_R = tracks.rig.triangulate(tracks.uvd_px)
    expected = np.einsum("mij,mj->mi", X_RG[tracks.frame, :3, :3], p_G[tracks.landmark])
    expected += X_RG[tracks.frame, :3, 3]
    # the depth of one of the two may be absurd, and its gate with it
    everything = np.arange(len(p_R))
    gate = np.minimum(*(triangulation_gate_m(tracks, everything, p) for p in (p_R, expected)))
    near = np.linalg.norm(p_R - expected, axis=1) < gate
    total = np.bincount(tracks.frame, minlength=tracks.n_frames)
    return np.asarray(np.bincount(tracks.frame, near, tracks.n_frames) / np.maximum(total, 1))


def ransac_orientation(p_R: Array, p_G: Array, gate_m: Array, rng: np.random.Generator) -> tuple[Array, int]:
    """X_RG with p_R ~ X_RG p_G for most of (n, 3) pairs, and how many agree within gate_m (n,)."""
    best, count = np.ones(len(p_R), bool), 0
    for _ in range(100):
        pick = rng.choice(len(p_R), 3, replace=False)
        X = fit_rigid(p_R[pick], p_G[pick])
        agree = np.linalg.norm(transform_points(X, p_G) - p_R, axis=1) < gate_m
        if agree.sum() > count:
            best, count = agree, int(agree.sum())
    if count < 3:
        return np.eye(4), count
    return fit_rigid(p_R[best], p_G[best]), count


def bridge(time_s: Array, X_NG: Array, connected: Bools) -> Array:
    """Fill the frames between and outside the connected ones by a constant rate, in N.

    Over a long gap full revolutions are ambiguous: the rotation nearest to the rate on both sides is taken.
    """
    X, index = X_NG.copy(), np.flatnonzero(connected)
    R, p = X[:, :3, :3], X[:, :3, 3]
    rates, centres = interval_rates(time_s[index], R[index])
    for a, b in pairwise(index):
        dt = time_s[b] - time_s[a]
        near = rates[np.argsort(np.abs(centres - 0.5 * (time_s[a] + time_s[b])))[:3]]
        turn = (
            nearest_branch(log_so3(R[a].T @ R[b]), np.median(near, axis=0) * dt) if b > a + 1 else np.zeros(3)
        )
        for k in range(a + 1, b):
            share = (time_s[k] - time_s[a]) / dt
            X[k] = make_pose(R[a] @ exp_so3(share * turn), (1 - share) * p[a] + share * p[b])
    first, last = index[0], index[-1]
    velocity = (p[last] - p[first]) / (time_s[last] - time_s[first])
    for k in [*range(first), *range(last + 1, len(X))]:
        edge, rate = (first, rates[0]) if k < first else (last, rates[-1])
        dt = time_s[k] - time_s[edge]
        X[k] = make_pose(R[edge] @ exp_so3(dt * rate), p[edge] + dt * velocity)
    return X


def nearest_branch(turn: Array, expected: Array) -> Array:
    """The rotation vector equal to ``turn`` (3,) up to full revolutions, nearest to ``expected`` (3,)."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-9:
        return turn
    axis = turn / angle
    revolutions = np.round((float(axis @ expected) - angle) / (2.0 * np.pi))
    return np.asarray(axis * (angle + 2.0 * np.pi * revolutions))
