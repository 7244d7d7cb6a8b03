"""A sequence of thousands of frames: a stream over them, key frames for map and mass properties, all states.

Matching all frames with all and solving all states with the landmarks eliminated grow with the square and the
cube of their number. The stream does not: it keeps the features of key frames only, by which it recognises
what appears again. Its key frames are solved together, from the motion that the window found; the states of
the other frames follow by a smoother in the map that results. Surface, checks and pictures are made with the
key frames.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from polhode.backend import align_online_estimate, estimate_motion, with_calibration
from polhode.backend.between_key_frames import first_states, smooth_between
from polhode.backend.initialization.multistart import KnownMotion
from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.frontend.features.stereo import StereoFeatures
from polhode.geometry.lie import Ints, inverse_pose
from polhode.pipeline.context import RunContext
from polhode.pipeline.correspondences import features_in_turn
from polhode.pipeline.find_motion import MotionSolution
from polhode.pipeline.runner import stage
from polhode.pipeline.stream.stream import CameraMotion, Extracted, Stream
from polhode.pipeline.stream_results import Streamed
from polhode.records.estimate import InitialMotion, OnlineEstimate
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.runtime.errors import RunFailure

NONE = np.zeros(0, dtype=np.int64)
NO_LINKS = RelativePoses(NONE, NONE, np.zeros((0, 4, 4)), NONE)
"""The tracks of a stream connect the frames of a long sequence."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LongSolution:
    """The solution of the key frames, and what follows for all frames."""

    frames: Ints
    """(K,) the key frames"""
    features: Sequence[StereoFeatures]
    """Of the key frames"""
    motion: MotionSolution
    """Of the key frames"""
    answer: MotionSolution
    """Of all frames, with observations of the key frames' map"""
    key_online: OnlineEstimate
    """Of the key frames, as each came"""
    online: OnlineEstimate
    """Of all frames"""


def is_long(context: RunContext) -> bool:
    """Whether the sequence is solved by key frames."""
    return len(context.sequence) > context.config.key_frames.above


@stage("frontend", ["frontend", "backend", "key_frames", "seed"], is_stored=False)
def stream_sequence(context: RunContext, streamed: Streamed | None) -> Streamed:
    """All pairs of the sequence through the stages of a stream, as fast as they go, unless that was done."""
    if streamed is not None and streamed.observations:
        return streamed
    sequence, config = context.sequence, context.config
    camera = CameraMotion(
        sequence.sigma_camera_p_m,
        sequence.sigma_camera_theta_rad,
        sequence.wrench,
        sequence.poses_stated,
        sequence.has_ranges,
    )
    stream = Stream(config, sequence.calibration, camera)
    stream.rectifier = context.rectifier
    features = features_in_turn(context, config.frontend)
    with context.progress.stage("stream", len(sequence)) as advance:
        for timestamp_ns, X_NC, found in zip(sequence.timestamps_ns, sequence.X_NC, features, strict=True):
            # without images: nothing is made ahead, as no frame has to be waited for
            stream.add(int(timestamp_ns), X_NC, Extracted(found, None, 0.0))
            advance()
    return stream.streamed(())


@stage("backend", ["backend"], is_stored=False)
def solve_long(context: RunContext, streamed: Streamed) -> LongSolution:
    """Key frames, then all frames. Raises RunFailure when no consistent motion is found."""
    config, times_ns = context.config, context.sequence.timestamps_ns
    tracks = _tracks(context, streamed)
    # those whose poses the window found, with eight observations of landmarks that other key frames see
    seen, every = np.bincount(tracks.frame, minlength=tracks.n_frames), streamed.key_frames
    good = np.flatnonzero((every >= streamed.found_from) & (seen[every] >= 8))
    keys, features = every[good], [streamed.features[n] for n in good.tolist()]
    if len(keys) < 3:
        raise RunFailure(f"no consistent motion: only {len(keys)} key frames share landmarks with others")
    _log.info("%d of %d frames are key frames", len(keys), len(times_ns))
    motion = _solve_keys(context, tracks, keys, streamed.online)
    found = motion.estimate.calibration
    if found is not None and found.correction is not None and motion.tracks.calibration is not None:
        tracks = tracks.freed(found.correction, motion.tracks.calibration)
    guess = first_states(tracks, keys, motion.estimate, streamed.online, streamed.found_from, config.backend)
    with context.progress.stage("states of all frames", 1) as advance:
        all_tracks, all_frames = smooth_between(tracks, keys, motion.estimate, guess, config.backend)
        advance()
    answer = MotionSolution(all_tracks, all_frames, NO_LINKS)
    online = align_online_estimate(streamed.online, all_frames)
    key_online = OnlineEstimate(**{each.name: getattr(online, each.name)[keys] for each in fields(online)})
    return LongSolution(keys, features, motion, answer, key_online, online)


def _tracks(context: RunContext, streamed: Streamed) -> StereoTracks:
    """Observations of all frames, of the landmarks that two key frames see."""
    sequence = context.sequence
    frame = np.repeat(np.arange(len(sequence)), [len(seen.landmark) for seen in streamed.observations])
    label = np.concatenate([seen.landmark for seen in streamed.observations]).astype(np.int64)
    of_keys = np.isin(frame, streamed.key_frames[streamed.key_frames >= streamed.found_from])
    views = np.bincount(label[of_keys], minlength=int(label.max(initial=-1)) + 1)
    used = np.flatnonzero(views[label] >= 2)
    landmark = np.unique(label[used], return_inverse=True)[1].reshape(-1)

    uvd_px, sigma_px = (
        np.concatenate([getattr(seen, name) for seen in streamed.observations])[used].astype(np.float64)
        for name in ("uvd_px", "sigma_px")
    )
    return StereoTracks(
        context.rig,
        sequence.timestamps_ns,
        context.X_NR,
        frame[used].astype(np.int64),
        landmark.astype(np.int64),
        uvd_px,
        sigma_px,
        sigma_camera_p_m=sequence.sigma_camera_p_m,
        sigma_camera_theta_rad=sequence.sigma_camera_theta_rad,
        X_BR=sequence.calibration.X_BC0 @ context.rectifier.X_CR,
        wrench=sequence.wrench,
        calibration=context.calibration_effects,
    )


def _solve_keys(
    context: RunContext, tracks: StereoTracks, keys: Ints, online: OnlineEstimate
) -> MotionSolution:
    """All key frames at once, from the window's states."""
    rows = np.flatnonzero(np.isin(tracks.frame, keys))
    landmark = np.unique(tracks.landmark[rows], return_inverse=True)[1].reshape(-1)
    part = replace(
        tracks,
        timestamps_ns=tracks.timestamps_ns[keys],
        X_NR=tracks.X_NR[keys],
        frame=np.searchsorted(keys, tracks.frame[rows]),
        landmark=landmark.astype(np.int64),
        uvd_px=tracks.uvd_px[rows],
        sigma_px=tracks.sigma_px[rows],
    )
    k1, k2 = online.k[-1]
    J_G = online.R_GP[-1] @ np.diag(np.exp([k1, 0.0, -k2])) @ online.R_GP[-1].T
    w_G = np.einsum("fij,fj->fi", online.R_GP[keys], online.w_P[keys])
    known = KnownMotion(online.v_N[keys], w_G, online.com_G[-1], second_moments_from_inertia(J_G))
    X_RG = inverse_pose(part.X_NR) @ online.X_NG[keys]
    initial = InitialMotion(X_RG, np.ones(len(keys), dtype=np.bool_))
    config = context.config.backend
    estimate = estimate_motion(part, initial, config, context.progress, known)
    return MotionSolution(*with_calibration(part, estimate, config, context.progress), NO_LINKS)
