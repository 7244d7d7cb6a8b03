"""From correspondences to the motion: solve, match again with the motion found, keep what fits better."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.backend import estimate_motion, initialize_motion
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import MIN_INLIERS, is_from_second
from polhode.frontend.tracks.duplicates import merge_duplicates
from polhode.frontend.tracks.guided_matching import consistent_matches, reconnect
from polhode.frontend.tracks.track_refinement import refine_tracks
from polhode.frontend.tracks.tracks import Association, join_matches
from polhode.geometry.lie import Array, Bools, inverse_pose
from polhode.pipeline.consistency_check import contradicts_first_method, fits_worse
from polhode.pipeline.context import RunContext
from polhode.pipeline.correspondences import Correspondences, add_second_method
from polhode.pipeline.runner import stage
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.runtime.errors import RunFailure

CONSISTENCY_PX = 5.0
"""A match made without prediction that the first motion contradicts by more is wrong."""
NO_IMPROVEMENT = "the second feature method brings no improvement and is not used"
_log = logging.getLogger(__name__)
MAX_LOST_SHARE = 0.05
"""Share of the frames that show the target but have no pose; above it the second method is tried."""


def pose_RG(tracks: StereoTracks, estimate: MotionEstimate) -> Array:
    """(F, 4, 4) pose of the target in the rectified left camera."""
    return inverse_pose(tracks.X_NR) @ estimate.X_NG


@dataclass(frozen=True)
class MotionSolution:
    """An estimate of the motion with the data that it was made from."""

    tracks: StereoTracks
    estimate: MotionEstimate
    links: RelativePoses

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
    return (
        initial if initial.initial is None else _solve_repeatedly(context, correspondences, initial.initial)
    )


@stage("frontend", ["frontend", "seed"], is_stored=False)
def second_correspondences(
    context: RunContext, first: Correspondences, attempt: Attempt
) -> Correspondences | None:
    """The correspondences of both feature methods, where the first leaves frames with too few observations.

    None: they are not needed, or the second method adds nothing.
    """
    second, solved = context.config.frontend.second_method, attempt.solved
    if second is None or (solved is not None and attempt.failure):
        return None
    if solved is None:
        _log.info("%s; the second feature method is tried", attempt.failure)
    elif not _has_too_few_observations(context, solved, first):
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
            return MotionSolution(solved.tracks, solved.estimate, both.links)
        _log.info(NO_IMPROVEMENT)
    if attempt.solved is None or attempt.failure:
        raise RunFailure(attempt.failure)
    solved = _refine(context, first.features, attempt.solved)
    return MotionSolution(solved.tracks, solved.estimate, first.links)


def _has_too_few_observations(
    context: RunContext, solved: SolvedTracks, correspondences: Correspondences
) -> bool:
    """Whether frames with features have few observations, or many of them no pose, or the solver did not
    converge."""
    if not solved.estimate.solver.converged:
        return True
    has_features = np.array([len(features) > 0 for features in correspondences.features])
    observations = np.bincount(solved.tracks.frame, minlength=len(has_features))[has_features]
    lost = np.sum(has_features & ~solved.motion.connected)
    return bool(
        np.median(observations) < context.config.frontend.features.second_below
        or lost > MAX_LOST_SHARE * np.sum(has_features)
    )


def _solve_with_second_method(
    context: RunContext, first: SolvedTracks | None, both: Correspondences
) -> SolvedTracks | None:
    """The solution from both methods; None if it fits worse or connects fewer frames than the first one's."""
    initial = initial_motion(context, both)
    attempt = first_motion(context, both, initial)
    if attempt.solved is None:
        _log.info("with the second feature method: %s", attempt.failure)
        return None
    if attempt.failure:
        _log.info("the solution of the round before is kept: %s", attempt.failure)
    solved = _refine(context, both.features, attempt.solved)
    if first is None:
        return solved
    connected = first.motion.connected
    fewer = np.sum(solved.motion.connected) < np.sum(connected)
    contradicts = contradicts_first_method(
        (solved.tracks, solved.estimate), (first.tracks, first.estimate), connected
    )
    return None if fewer or contradicts else solved


def _solve_repeatedly(
    context: RunContext, correspondences: Correspondences, motion: InitialMotion
) -> Attempt:
    """Solve, match again with the solved motion, and repeat while lost frames are recovered."""
    config, guided, features = context.config, context.config.frontend.guided, correspondences.features
    matches = consistent_matches(correspondences.matches, features, motion, context.rig, CONSISTENCY_PX)
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


ChangedTracks = tuple[Sequence[StereoFeatures], Association]
RefinementStep = Callable[[RunContext, Sequence[StereoFeatures], SolvedTracks], ChangedTracks | None]


def _refine(context: RunContext, features: Sequence[StereoFeatures], solved: SolvedTracks) -> SolvedTracks:
    """Merge duplicate landmarks, then refine the tracks' positions; a step that fits worse is undone."""
    steps: tuple[RefinementStep, ...] = (_merge_duplicate_landmarks, _refine_track_positions)
    for step in steps:
        changed = step(context, features, solved)
        if changed is None:
            continue
        tracks = context.tracks(*changed)
        try:
            estimate = estimate_motion(
                tracks, solved.motion, context.config.backend, progress=context.progress
            )
        except RunFailure as failure:
            _log.info("no motion is found with these tracks, which are not used: %s", failure)
            continue
        if fits_worse(estimate, solved.estimate):
            _log.info("these tracks fit worse and are not used")
            continue
        features, association = changed
        motion = InitialMotion(pose_RG(tracks, estimate), solved.motion.connected)
        solved = SolvedTracks(association, motion, tracks, estimate)
    return solved


def _merge_duplicate_landmarks(
    context: RunContext, features: Sequence[StereoFeatures], solved: SolvedTracks
) -> ChangedTracks | None:
    """Merge landmarks that the motion shows to be the same point; None: there are none."""
    before, guided = solved.association, context.config.frontend.guided
    merged = merge_duplicates(features, before, solved.motion, context.rig, guided)
    n_merged = before.n_landmarks - merged.n_landmarks
    _log.info("%d of %d landmarks are duplicates and merged", n_merged, before.n_landmarks)
    return (features, merged) if n_merged else None


def _refine_track_positions(
    context: RunContext, features: Sequence[StereoFeatures], solved: SolvedTracks
) -> ChangedTracks | None:
    """Align each landmark to the same surface point in every view; None: the surface is not known there."""
    if not any(seen.on_surface.any() for seen in features):
        return None
    shown, config = (context.sequence, context.rectifier), context.config.frontend
    return refine_tracks(*shown, features, solved.association, solved.motion, config, context.workers)
