"""In Rerun: a finished run, with its sequence the images too; or a sequence alone, as recorded."""

import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from polhode.frontend.rectification import RectifiedPair, rectified_pair
from polhode.pipeline.context import rectifier_of
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.records.tracks import StereoTracks
from polhode.report.polhode_and_inertia_figures import torque_free_path
from polhode.report.residual_figures import INLIER_WEIGHT, rms_per_frame
from polhode.run_directory.recording import require_recording
from polhode.run_directory.stored_run import StoredMotion, StoredRun, read_stored_run
from polhode.runtime.errors import InputError
from polhode.runtime.progress import NOTE, Progress
from polhode.viewer.blueprint import Eyes, arrangement, before_polhode, beside_camera
from polhode.viewer.recorder import Recorder, ShownFeatures, ShownFrame, ShownMotion, ShownRig, known_ratios
from polhode.viewer.target import ViewTarget

MAX_FACES = 40_000
"""Of the mesh that is shown; a finer one is thinned."""
MAX_PICTURES = 600
"""Frames that are shown with their images; of a longer sequence every second, third, ... one."""

_log = logging.getLogger(__name__)
Pictures = Callable[[int], RectifiedPair | None]
"""The rectified pair of a frame; None: it is not shown"""


def show_run(run_folder: Path, sequence_folder: Path | None, target: ViewTarget, progress: Progress) -> None:
    """Show a run that reached an estimate; without its sequence there are no images.

    Raises InputError: the run is damaged or has no motion, the sequence is another one.
    """
    run = read_stored_run(run_folder, run_folder.name)
    if run.motion is None or run.tracks is None:
        raise InputError(f"{run_folder}: this run has no motion to show; {run_folder / 'log.txt'} tells why")
    pictures: Pictures = dict[int, RectifiedPair]().get
    has_right = False
    if sequence_folder is None:
        _log.log(NOTE, "no images are shown: --data SEQ gives the sequence that the run was made from")
    else:
        sequence = open_sequence(sequence_folder)
        require_recording(run.summary.data, sequence_folder, "give the sequence that the run was made from")
        pictures, has_right = pictures_of(sequence, run.tracks), not sequence.has_ranges
    rig = ShownRig.rectified(run.tracks.rig)
    trajectory, X_NR = run.motion.trajectory, run.tracks.X_NR
    distance_m = float(np.linalg.norm(trajectory.r_N[0] - X_NR[0, :3, 3]))
    eyes = Eyes(beside_camera(X_NR[0], distance_m), before_polhode(trajectory.w_P))
    blueprint = arrangement(eyes, has_motion=True, landmarks_add_up=True, has_right=has_right)
    with target.opened(run_folder.resolve().name, rig, blueprint) as recorder:
        show_stored_run(run, run.motion, run.tracks, pictures, recorder, progress)


def pictures_of(sequence: StereoSequence, tracks: StereoTracks) -> Pictures:
    """The pairs of a run's frames, found by their time, at most MAX_PICTURES of them."""
    rectifier = rectifier_of(sequence)
    stamps = {int(stamp): k for k, stamp in enumerate(sequence.timestamps_ns)}
    every = -(-tracks.n_frames // MAX_PICTURES)

    def pair(k: int) -> RectifiedPair | None:
        found = stamps.get(int(tracks.timestamps_ns[k]))
        return None if found is None or k % every else rectified_pair(sequence, rectifier, found)

    return pair


def show_stored_run(
    run: StoredRun,
    motion: StoredMotion,
    tracks: StereoTracks,
    pictures: Pictures,
    recorder: Recorder,
    progress: Progress,
) -> None:
    """Log all frames of a run, its polhode and its mesh."""
    path = motion.trajectory
    recorder.log_polhode_path(torque_free_path(path.time_s, path.w_P, motion.moments))
    if run.surface is not None and len(run.surface.mesh.faces):
        recorder.log_surface(run.surface, MAX_FACES, static=True)
    with progress.stage("recording", tracks.n_frames) as advance:
        for frame in shown_frames(run, motion, tracks, pictures):
            recorder.log_frame(frame)
            advance()


def shown_frames(
    run: StoredRun, motion: StoredMotion, tracks: StereoTracks, pictures: Pictures
) -> Iterator[ShownFrame]:
    """What is shown of each frame of a run."""
    path, residuals, landmarks, online = motion.trajectory, run.residuals, run.landmarks, run.online
    order = np.argsort(tracks.frame, kind="stable")
    ends = np.searchsorted(tracks.frame[order], np.arange(tracks.n_frames + 1))
    weights = np.ones(len(tracks.frame)) if residuals is None else residuals.inlier_weight
    rms = None if residuals is None else rms_per_frame(tracks, residuals)
    p_G = np.zeros((0, 3)) if landmarks is None else landmarks.p_G
    # the first frame that observes each landmark; 0 where the tracks are those of other landmarks
    first = np.zeros(len(p_G), dtype=np.int64)
    if len(p_G) == tracks.n_landmarks:
        first[:] = tracks.n_frames
        np.minimum.at(first, tracks.landmark, tracks.frame)
    ratios = None
    if online is not None and np.array_equal(online.timestamps_ns, tracks.timestamps_ns):
        ratios = known_ratios(online.k, online.cov_k, online.determined[:, :2])
    for k in range(tracks.n_frames):
        rows, pair = order[ends[k] : ends[k + 1]], pictures(k)
        agrees = weights[rows] >= INLIER_WEIGHT
        states = (path.r_N[k], path.v_N[k], path.R_NP[k], path.w_P[k], motion.covariance.covariance[k])
        yield ShownFrame(
            number=k,
            time_s=float(tracks.time_s[k]),
            X_NL=tracks.X_NR[k],
            left=None if pair is None else pair.left,
            right=None if pair is None or pair.measured is not None else pair.right,
            features=ShownFeatures(tracks.uvd_px[rows, :2], tracks.landmark[rows], agrees),
            motion=ShownMotion(*states, motion.X_NG[k], motion.moments),
            ratios=None if ratios is None else (ratios[0][k], ratios[1][k]),
            residual_rms_px=None if rms is None else rms[k],
            landmarks_G=p_G[first == k],
        )


def show_sequence(sequence_folder: Path, target: ViewTarget, progress: Progress) -> None:
    """Show a sequence. Raises InputError as ``open_sequence``."""
    sequence = open_sequence(sequence_folder)
    rig = ShownRig.recorded(sequence.calibration)
    blueprint = arrangement(
        Eyes(beside_camera(sequence.X_NC[0], rig.plane_m)),
        has_motion=False,
        landmarks_add_up=True,
        has_right=not sequence.has_ranges,
    )
    opened = target.opened(sequence_folder.resolve().name, rig, blueprint)
    with opened as recorder, progress.stage("recording", len(sequence)) as advance:
        for frame in recorded_frames(sequence):
            recorder.log_frame(frame)
            advance()


def recorded_frames(sequence: StereoSequence) -> Iterator[ShownFrame]:
    """Every pair of a sequence; of one with range images the left images alone."""
    for k in range(len(sequence)):
        pair = sequence.read_pair(k)
        yield ShownFrame(
            number=k,
            time_s=1e-9 * int(sequence.timestamps_ns[k] - sequence.timestamps_ns[0]),
            X_NL=sequence.X_NC[k],
            left=pair.left,
            right=None if sequence.has_ranges else pair.right,
            mask_left=pair.mask_left,
            mask_right=None if sequence.has_ranges else pair.mask_right,
        )
