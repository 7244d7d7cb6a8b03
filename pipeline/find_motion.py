"""From correspondences to the motion: solve, match again with the motion found, keep what fits better."""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.backend import estimate_motion, initialize_motion
from polhode.config.frontend_settings import Frontend
from polhode.errors import RunFailure
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import MIN_INLIERS, is_from_second
from polhode.frontend.tracks.duplicates import merge_duplicates
from polhode.frontend.tracks.guided_matching import consistent_matches, reconnect
from polhode.frontend.tracks.track_refinement import refine_tracks
from polhode.frontend.tracks.tracks import Association, join_matches
from polhode.lie import Array, inverse_pose
from polhode.pipeline.consistency_check import contradicts_first_method, fits_worse
from polhode.pipeline.context import RunContext
from polhode.pipeline.correspondences import Correspondences, add_second_method
from polhode.records import InitialMotion, MotionEstimate, RelativePoses, StereoTracks

CONSISTENCY_PX = 5.0
"""A match made without prediction that the first motion contradicts by more is wrong."""
_log = logging.getLogger(__name__)
MAX_LOST_SHARE = 0.05
"""Share of the frames that show the target but have no pose; above it the second method is tried."""


@dataclass(frozen=True)
class MotionSolution:
    """An estimate of the motion with the data that it was made from."""

    features: Sequence[StereoFeatures]
    """Of each frame, F, of both methods where there are two"""
    association: Association
    """Which features are one landmark"""
    motion: InitialMotion
    """Solved poses, and which frames are connected by measurements"""
    tracks: StereoTracks
    estimate: MotionEstimate
    links: RelativePoses


def pose_RG(tracks: StereoTracks, estimate: MotionEstimate) -> Array:
    """(F, 4, 4) pose of the target in the rectified left camera."""
    return inverse_pose(tracks.X_NR) @ estimate.X_NG


def find_motion(context: RunContext, correspondences: Correspondences) -> Iterator[MotionSolution]:
    """Successively better solutions; the last one counts, the earlier ones stand should a later step fail.

    Where the first feature method leaves frames with too few observations, the second one is added. The
    solution from both is taken unless it fits worse. Raises RunFailure when no consistent motion is found.
    """
    first, failure = None, None
    second_method = context.config.frontend.second_method
    try:
        for first in solve_repeatedly(context, correspondences):
            yield first
    except RunFailure as error:
        if first is not None or second_method is None:
            raise
        _log.info("%s; the second feature method is tried", error)
        failure = error
    if second_method is not None and (
        first is None or _has_too_few_observations(context, first, correspondences)
    ):
        try:
            both = _solve_with_second_method(context, first, correspondences, second_method)
        except Exception:
            # The second method may fail; the motion that is already found must not be lost with it.
            if first is None:
                raise
            _log.warning("the second feature method failed", exc_info=True)
            both = None
        if both is not None:
            yield both
            return
        _log.info("the second feature method brings no improvement and is not used")
    if first is None:
        assert failure is not None
        raise failure
    yield refine(context, first)


def _has_too_few_observations(
    context: RunContext, solution: MotionSolution, correspondences: Correspondences
) -> bool:
    """Whether frames with features have few observations, or many of them no pose, or the solver did not
    converge."""
    if not solution.estimate.solver.converged:
        return True
    has_features = np.array([len(features) > 0 for features in correspondences.features])
    observations = np.bincount(solution.tracks.frame, minlength=len(has_features))[has_features]
    lost = np.sum(has_features & ~solution.motion.connected)
    return bool(
        np.median(observations) < context.config.frontend.features.second_below
        or lost > MAX_LOST_SHARE * np.sum(has_features)
    )


def _solve_with_second_method(
    context: RunContext, first: MotionSolution | None, correspondences: Correspondences, second: Frontend
) -> MotionSolution | None:
    """The solution from both methods; None if it fits worse or connects fewer frames than the first one's."""
    X_RG = None if first is None else first.motion.X_RG
    both = add_second_method(context, correspondences, second, X_RG)
    if not any(is_from_second(match, correspondences.features) for match in both.matches):
        return None
    try:
        solution = refine(context, _last(solve_repeatedly(context, both)))
    except RunFailure as failure:
        _log.info("with the second feature method: %s", failure)
        return None
    if first is None:
        return solution
    connected = first.motion.connected
    fewer = np.sum(solution.motion.connected) < np.sum(connected)
    contradicts = contradicts_first_method(
        (solution.tracks, solution.estimate), (first.tracks, first.estimate), connected
    )
    return None if fewer or contradicts else solution


def _last(solutions: Iterator[MotionSolution]) -> MotionSolution:
    """The last solution; a failure after the first one ends the iteration."""
    solution = next(solutions)
    try:
        for better in solutions:
            solution = better
    except RunFailure as failure:
        _log.info("the solution of the round before is kept: %s", failure)
    return solution


def solve_repeatedly(context: RunContext, correspondences: Correspondences) -> Iterator[MotionSolution]:
    """Solve, match again with the solved motion, and repeat while lost frames are recovered."""
    config, guided = context.config, context.config.frontend.guided
    once, backend = context.stages.once, context.config.backend.for_motion
    features, links = correspondences.features, correspondences.links
    correspondences.require_features(MIN_INLIERS)
    with context.clock("initialization"), context.progress.stage("first motion", 1) as advance:
        motion = once(initialize_motion, correspondences.tracks(context), links, backend)
        advance()
    matches = consistent_matches(correspondences.matches, features, motion, context.rig, CONSISTENCY_PX)
    association = join_matches(features, matches)
    for number in range(guided.rounds):
        before = motion.connected
        with context.clock("frontend"):
            relocated = once(reconnect, features, association, motion, context.rig, guided, config.seed)
            association, motion = relocated.association, relocated.motion
            tracks = context.tracks(features, association)
        _log.info("round %d: %d of %d frames connected", number + 1, motion.connected.sum(), len(before))
        if number > 0 and np.array_equal(motion.connected, before):
            break
        with context.clock("backend"):
            estimate = once(estimate_motion, tracks, motion, backend, progress=context.progress)
        motion = InitialMotion(pose_RG(tracks, estimate), motion.connected)
        yield MotionSolution(features, association, motion, tracks, estimate, links)


def refine(context: RunContext, solution: MotionSolution) -> MotionSolution:
    """Merge duplicate landmarks, then refine the tracks' positions; a step that fits worse is undone."""
    for step in (_merge_duplicate_landmarks, _refine_track_positions):
        with context.clock("frontend"):
            changed = step(context, solution)
            if changed is None:
                continue
            features, association = changed
            tracks = context.tracks(features, association)
        try:
            with context.clock("backend"):
                backend = context.config.backend.for_motion
                estimate = context.stages.once(
                    estimate_motion, tracks, solution.motion, backend, progress=context.progress
                )
        except RunFailure as failure:
            _log.info("no motion is found with these tracks, which are not used: %s", failure)
            continue
        if fits_worse(estimate, solution.estimate):
            _log.info("these tracks fit worse and are not used")
            continue
        motion = InitialMotion(pose_RG(tracks, estimate), solution.motion.connected)
        solution = replace(
            solution,
            features=features,
            association=association,
            motion=motion,
            tracks=tracks,
            estimate=estimate,
        )
    return solution


ChangedTracks = tuple[Sequence[StereoFeatures], Association]
RefinementStep = Callable[[RunContext, MotionSolution], ChangedTracks | None]


def _merge_duplicate_landmarks(context: RunContext, solution: MotionSolution) -> ChangedTracks | None:
    """Merge landmarks that the motion shows to be the same point; None: there are none."""
    before, guided = solution.association, context.config.frontend.guided
    merged = context.stages.once(
        merge_duplicates, solution.features, before, solution.motion, context.rig, guided
    )
    n_merged = before.n_landmarks - merged.n_landmarks
    _log.info("%d of %d landmarks are duplicates and merged", n_merged, before.n_landmarks)
    return (solution.features, merged) if n_merged else None


def _refine_track_positions(context: RunContext, solution: MotionSolution) -> ChangedTracks | None:
    """Align each landmark to the same surface point in every view; None: the surface is not known there."""
    if not any(seen.on_surface.any() for seen in solution.features):
        return None
    return refine_tracks(
        context.sequence,
        context.rectifier,
        solution.features,
        solution.association,
        solution.motion,
        context.config.frontend,
        context.workers,
    )
