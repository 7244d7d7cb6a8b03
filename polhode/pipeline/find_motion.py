"""From correspondences to the motion: solve, match again with the motion found, keep what fits better.

A wrong motion would guide the matching towards matches that confirm it. Three signs betray it: the solver
does not converge, more observations are outliers, or all of them scatter more. A method whose features
follow the illumination instead of the surface is betrayed by a motion that differs from the first method's.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.backend import estimate_motion, initialize_motion, with_calibration
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import MIN_INLIERS, is_from_second
from polhode.frontend.tracks.guided_matching import consistent_matches, reconnect
from polhode.frontend.tracks.loop_closure import merge_duplicates
from polhode.frontend.tracks.track_refinement import refine_tracks
from polhode.frontend.tracks.tracks import Association, join_matches
from polhode.geometry.lie import Array, Bools, inverse_pose, log_so3
from polhode.geometry.rigid_fit import mean_rotation
from polhode.pipeline.context import RunContext
from polhode.pipeline.correspondences import Correspondences, add_second_method
from polhode.pipeline.runner import stage
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.runtime.errors import RunFailure

MAX_NOISE_GROWTH = 1.08
"""Largest accepted growth of the pixel scatter: merged landmarks of TS38 scatter 4 % more and help, those of
a shaded asteroid 14 % more and harm."""
SAME_MOTION_DEG = 1.0
"""Attitudes from two methods that see the same motion differ by less, in the median: by at most 0.2 degrees
on the scenes of the benchmark, by 7 and 12 where the second method's features followed the light."""
NO_IMPROVEMENT = "the second feature method brings no improvement and is not used"
_log = logging.getLogger(__name__)


def pose_RG(tracks: StereoTracks, estimate: MotionEstimate) -> Array:
    """(F, 4, 4) pose of the target in the rectified left camera."""
    return inverse_pose(tracks.X_NR) @ estimate.X_NG


@dataclass(frozen=True)
class MotionSolution:
    """An estimate of the motion with the data that it was made from."""

    tracks: StereoTracks
    """Freed of errors of the calibration that they determine"""
    estimate: MotionEstimate
    links: RelativePoses
    measured: StereoTracks | None = None
    """The tracks as measured; None: nothing was taken off them"""

    @property
    def X_RG(self) -> Array:
        """(F, 4, 4) pose of the target in the rectified left camera."""
        return pose_RG(self.tracks, self.estimate)

    @property
    def is_measured(self) -> Bools:
        """(F,) frames with observations"""
        return np.isin(np.arange(self.tracks.n_frames), self.tracks.frame)


@dataclass(frozen=True)
class SolvedTracks:
    """The same while features are associated."""

    association: Association
    """Which features are one landmark"""
    motion: InitialMotion
    """Solved poses, and which frames are connected by measurements"""
    tracks: StereoTracks
    estimate: MotionEstimate


@dataclass(frozen=True)
class Attempt:
    """What the first feature method gives."""

    initial: InitialMotion | None
    """Poses without dynamics"""
    solved: SolvedTracks | None = None
    failure: str = ""
    """Why there is no solution, or why the last round gave none"""


def find_motion(context: RunContext, correspondences: Correspondences) -> MotionSolution:
    """The stages of this module one after the other. Raises RunFailure when no consistent motion is found."""
    first = first_motion(context, correspondences, initial_motion(context, correspondences))
    second = second_correspondences(context, correspondences, first)
    return best_motion(context, correspondences, first, second)


@stage("initialization", ["frontend.tracks", "backend.for_motion"])
def initial_motion(context: RunContext, correspondences: Correspondences) -> Attempt:
    """Poses of the target by pose graph and bundle adjustment, without dynamics."""
    try:
        correspondences.require_features(MIN_INLIERS)
        with context.progress.stage("first motion", 1) as advance:
            backend = context.config.backend
            tracks = correspondences.tracks(context)
            initial = initialize_motion(tracks, correspondences.links, backend)
            advance()
    except RunFailure as error:
        return Attempt(None, failure=str(error))
    return Attempt(initial)


@stage("backend", ["frontend", "backend.for_motion", "seed"])
def first_motion(context: RunContext, correspondences: Correspondences, initial: Attempt) -> Attempt:
    """The motion with dynamics from the first feature method, matched again while that recovers frames."""
    motion = initial.initial
    if motion is None:
        return initial
    config, guided, features = context.config, context.config.frontend.guided, correspondences.features
    # a match made without prediction that the first motion contradicts by more than 5 px is wrong
    matches = consistent_matches(correspondences.matches, features, motion, context.rig, 5.0)
    association, attempt = join_matches(features, matches), Attempt(motion)
    for number in range(guided.rounds):
        before = motion.connected
        try:
            relocated = reconnect(features, association, motion, context.rig, guided, config.seed)
            association, motion = relocated.association, relocated.motion
            tracks = context.tracks(features, association)
            _log.info("round %d: %d of %d frames connected", number + 1, motion.connected.sum(), len(before))
            if number > 0 and np.array_equal(motion.connected, before):
                break
            estimate = estimate_motion(tracks, motion, config.backend, progress=context.progress)
        except RunFailure as error:
            return replace(attempt, failure=str(error))
        motion = InitialMotion(pose_RG(tracks, estimate), motion.connected)
        attempt = Attempt(attempt.initial, SolvedTracks(association, motion, tracks, estimate))
    return attempt


@stage("frontend", ["frontend", "seed"], is_stored=False)
def second_correspondences(
    context: RunContext, first: Correspondences, attempt: Attempt
) -> Correspondences | None:
    """The correspondences of both feature methods, where the first leaves frames with too few observations.

    None: they are not needed, or the second method adds nothing.
    """
    frontend, solved = context.config.frontend, attempt.solved
    second = frontend.second_method
    if second is None or (solved is not None and attempt.failure):
        return None
    if solved is None:
        _log.info("%s; the second feature method is tried", attempt.failure)
    elif solved.estimate.solver.converged:
        has_features = np.array([len(features) > 0 for features in first.features])
        observations = np.bincount(solved.tracks.frame, minlength=len(has_features))[has_features]
        lost = np.sum(has_features & ~solved.motion.connected)
        enough = np.median(observations) >= frontend.features.second_below
        # of the frames that show the target
        if enough and lost <= 0.05 * np.sum(has_features):
            return None
    try:
        both = add_second_method(context, first, second, None if solved is None else solved.motion.X_RG)
        if any(is_from_second(match, first.features) for match in both.matches):
            return both
    except Exception:
        # The second method may fail; the motion that is already found must not be lost with it.
        if solved is None:
            raise
        _log.warning("the second feature method failed", exc_info=True)
    _log.info(NO_IMPROVEMENT)
    return None


@stage("backend", ["frontend", "backend.for_motion", "seed"])
def best_motion(
    context: RunContext, first: Correspondences, attempt: Attempt, both: Correspondences | None
) -> MotionSolution:
    """The solution from both feature methods unless it fits worse, or that of the first with refined tracks.

    Raises RunFailure when no consistent motion is found.
    """
    if both is not None:
        solved = None
        try:
            solved = _solve_with_second_method(context, attempt.solved, both)
        except Exception:
            if attempt.solved is None:
                raise
            _log.warning("the second feature method failed", exc_info=True)
        if solved is not None:
            return _with_calibration(context, solved, both.links)
        _log.info(NO_IMPROVEMENT)
    if attempt.solved is None or attempt.failure:
        raise RunFailure(attempt.failure)
    solved = _refine(context, first.features, attempt.solved)
    return _with_calibration(context, solved, first.links)


def _with_calibration(context: RunContext, solved: SolvedTracks, links: RelativePoses) -> MotionSolution:
    config, progress = context.config.backend, context.progress
    tracks, estimate = with_calibration(solved.tracks, solved.estimate, config, progress)
    return MotionSolution(tracks, estimate, links, None if tracks is solved.tracks else solved.tracks)


def _solve_with_second_method(
    context: RunContext, first: SolvedTracks | None, both: Correspondences
) -> SolvedTracks | None:
    """The solution from both methods; None if it fits worse or connects fewer frames than the first one's."""
    attempt = first_motion(context, both, initial_motion(context, both))
    if attempt.solved is None:
        _log.info("with the second feature method: %s", attempt.failure)
        return None
    if attempt.failure:
        _log.info("the solution of the round before is kept: %s", attempt.failure)
    solved = _refine(context, both.features, attempt.solved)
    if first is None:
        return solved
    connected = first.motion.connected
    if np.sum(solved.motion.connected) < np.sum(connected):
        return None
    return None if contradicts_first_method(solved, first, connected) else solved


def _refine(context: RunContext, features: Sequence[StereoFeatures], solved: SolvedTracks) -> SolvedTracks:
    """Merge duplicate landmarks, then align each landmark to the same surface point in every view, where the
    surface is known; a step that fits worse is undone."""
    frontend, shown = context.config.frontend, (context.sequence, context.rectifier)
    for step in ("merge", "align"):
        before, changed = solved.association, features
        if step == "merge":
            association = merge_duplicates(features, before, solved.motion, context.rig, frontend.guided)
            n_merged = before.n_landmarks - association.n_landmarks
            _log.info("%d of %d landmarks are duplicates and merged", n_merged, before.n_landmarks)
            if n_merged == 0:
                continue
        elif any(seen.on_surface.any() for seen in features):
            changed, association = refine_tracks(
                *shown, features, before, solved.motion, frontend, context.workers
            )
        else:
            continue
        tracks, config = context.tracks(changed, association), context.config.backend
        try:
            estimate = estimate_motion(tracks, solved.motion, config, progress=context.progress)
        except RunFailure as failure:
            _log.info("no motion is found with these tracks, which are not used: %s", failure)
            continue
        if fits_worse(estimate, solved.estimate):
            _log.info("these tracks fit worse and are not used")
            continue
        features = changed
        motion = InitialMotion(pose_RG(tracks, estimate), solved.motion.connected)
        solved = SolvedTracks(association, motion, tracks, estimate)
    return solved


def fits_worse(later: MotionEstimate, earlier: MotionEstimate) -> bool:
    """Whether the estimate from guided associations fits worse than the one from unguided ones.

    Outliers of both, of more than 4.5 standard deviations, are judged by the earlier estimate's pixel noise:
    with less scatter, more observations would count as outliers.
    """
    if earlier.solver.converged and not later.solver.converged:
        return True
    noise = earlier.noise
    sigma = np.maximum([noise.pixel_sigma_px, noise.pixel_sigma_px, noise.disparity_sigma_px], 1e-9)
    after, before = (
        float(np.mean(np.any(np.abs(each.residuals_px) > 4.5 * sigma, axis=1))) for each in (later, earlier)
    )
    growth = later.noise.pixel_sigma_px / max(noise.pixel_sigma_px, 1e-9)
    return after - before > 0.03 or growth > MAX_NOISE_GROWTH


def contradicts_first_method(both: SolvedTracks, first: SolvedTracks, connected: Bools) -> bool:
    """Whether the solution from two methods differs in motion from the first one's or fits its points worse.

    connected (F,): the frames that the first method connected. The tracks of both solutions contain the first
    method's observations; the residuals of those that they share are compared.
    """
    later, earlier = both.estimate, first.estimate
    if earlier.solver.converged != later.solver.converged:
        return earlier.solver.converged
    difference_deg = attitude_difference_deg(later, earlier, connected)
    noise = later.noise.pixel_sigma_px / max(earlier.noise.pixel_sigma_px, 1e-9)
    # coordinates of shared observations are equal to the last bit
    keys, first_keys = (
        list(zip(each.frame.tolist(), map(tuple, each.uvd_px.tolist()), strict=True))
        for each in (both.tracks, first.tracks)
    )
    row_of, scatter = {key: row for row, key in enumerate(first_keys)}, 1.0
    if rows := [row for row, key in enumerate(keys) if key in row_of]:
        after = float(np.median(np.abs(later.residuals_px[rows][:, :2])))
        known = [row_of[keys[row]] for row in rows]
        scatter = after / max(float(np.median(np.abs(earlier.residuals_px[known][:, :2]))), 1e-9)
    _log.info(
        "two feature methods: attitudes differ by %.3f deg; scatter is %.2f times the first method's, of its "
        "own points %.2f times",
        *(difference_deg, noise, scatter),
    )
    return difference_deg > SAME_MOTION_DEG or max(noise, scatter) > MAX_NOISE_GROWTH


def attitude_difference_deg(a: MotionEstimate, b: MotionEstimate, frames: Bools) -> float:
    """Median angle [deg] between the attitudes of two estimates over the frames (F,), after the best-fitting
    constant rotation between their body frames."""
    R_a, R_b = a.X_NG[frames, :3, :3], b.X_NG[frames, :3, :3]
    R_ba = mean_rotation(np.swapaxes(R_b, 1, 2) @ R_a)
    difference = log_so3(np.swapaxes(R_b @ R_ba, 1, 2) @ R_a)
    return float(np.rad2deg(np.median(np.linalg.norm(difference, axis=1))))
