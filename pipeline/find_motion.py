"""From what the frames show to the motion: solve, look again where it leads, keep what fits better."""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.backend import estimate_motion, initialize_motion
from polhode.config import Config
from polhode.config.frontend import Frontend
from polhode.errors import RunFailure
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.combined import of_second
from polhode.frontend.tracks.duplicates import merge_duplicates
from polhode.frontend.tracks.guided import consistent_matches, reconnect
from polhode.frontend.tracks.track_refinement import refine_tracks
from polhode.frontend.tracks.tracks import Association, join_matches
from polhode.lie import Array, inverse_pose
from polhode.pipeline.consistency_check import contradicts, revises
from polhode.pipeline.correspondences import Sight, look_again, workers
from polhode.pipeline.images import Images
from polhode.pipeline.stopwatch import Stopwatch
from polhode.progress import Progress
from polhode.records import InitialMotion, MotionEstimate, RelativePoses, StereoTracks

_log = logging.getLogger(__name__)
MANY_LOST = 0.05
"""Share of the frames that show the target but are lost, above which another look is worth its time."""


@dataclass(frozen=True)
class Found:
    """A motion with what it was found from."""

    features: Sequence[StereoFeatures]
    association: Association
    motion: InitialMotion
    """Solved poses, and which frames are measured"""
    tracks: StereoTracks
    estimate: MotionEstimate
    links: RelativePoses


def pose_RG(tracks: StereoTracks, estimate: MotionEstimate) -> Array:
    """(F, 4, 4) pose of the target in the rectified left camera."""
    return inverse_pose(tracks.X_NR) @ estimate.X_NG


def find_motion(
    images: Images, sight: Sight, config: Config, progress: Progress, clock: Stopwatch
) -> Iterator[Found]:
    """Ever better motions; the last one counts, the others stand should a later step fail.

    Where the first method of the front end leaves frames short, the second one looks too; what both see is
    solved, and taken unless it fits worse. Raises RunFailure: no consistent motion.
    """
    plain, failure = None, None
    second = config.frontend.second_method
    try:
        for plain in solved(images, sight, config, progress, clock):
            yield plain
    except RunFailure as error:
        if plain is not None or second is None:
            raise
        _log.info("%s; the second method of the front end looks for one", error)
        failure = error
    if second is not None and (plain is None or _leaves_short(plain, sight, config)):
        try:
            better = _better(plain, images, sight, second, config, progress, clock)
        except Exception:
            # another look is worth its while, but not the motion that is found already
            if plain is None:
                raise
            _log.warning("the second method of the front end failed", exc_info=True)
            better = None
        if better is not None:
            yield better
            return
        _log.info("what the second method of the front end adds is not used")
    if plain is None:
        assert failure is not None  # else there is a motion
        raise failure
    yield polished(plain, images, config, progress, clock)


def _leaves_short(found: Found, sight: Sight, config: Config) -> bool:
    """Whether the frames that show something have few observations, or many of them are lost, or the solver
    came to no end."""
    if not found.estimate.solver.converged:
        return True
    shows = np.array([len(features) > 0 for features in sight.features])
    observations = np.bincount(found.tracks.frame, minlength=len(shows))[shows]
    lost = np.sum(shows & ~found.motion.connected)
    return bool(
        np.median(observations) < config.frontend.features.second_below or lost > MANY_LOST * np.sum(shows)
    )


def _better(
    plain: Found | None,
    images: Images,
    sight: Sight,
    second: Frontend,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
) -> Found | None:
    """The motion from what both methods see, unless it fits worse or finds fewer frames."""
    X_RG = None if plain is None else plain.motion.X_RG
    both = look_again(images, sight, second, X_RG, config, progress, clock)
    if not any(of_second(match, sight.features) for match in both.matches):
        return None
    try:
        found = _last(solved(images, both, config, progress, clock))
        found = polished(found, images, config, progress, clock)
    except RunFailure as failure:
        _log.info("with the second method of the front end: %s", failure)
        return None
    if plain is None:
        return found
    measured = plain.motion.connected
    fewer = np.sum(found.motion.connected) < np.sum(measured)
    revised = revises((found.tracks, found.estimate), (plain.tracks, plain.estimate), measured)
    return None if fewer or revised else found


def _last(motions: Iterator[Found]) -> Found:
    """The last of them; a failure after the first one ends them."""
    found = next(motions)
    try:
        for better in motions:
            found = better
    except RunFailure as failure:
        _log.info("what was found before stands: %s", failure)
    return found


def solved(
    images: Images, sight: Sight, config: Config, progress: Progress, clock: Stopwatch
) -> Iterator[Found]:
    """Solve, and again as long as the solved motion finds frames that were lost before; the last counts."""
    rig, guided = images.rectifier.rig, config.frontend.guided
    features, links = sight.features, sight.links
    sight.require_features(config.frontend.pairs.min_inliers)
    with clock("initialization"), progress.stage("first motion", 1) as advance:
        motion = initialize_motion(sight.tracks(images, config), links, config.backend)
        advance()
    matches = consistent_matches(sight.matches, features, motion, rig, guided.consistency_px)
    association = join_matches(features, matches)
    for turn in range(guided.rounds):
        before = motion.connected
        with clock("frontend"):
            relocated = reconnect(features, association, motion, rig, guided, config.seed)
            association, motion = relocated.association, relocated.motion
            tracks = images.tracks(features, association, config)
        _log.info("round %d: %d of %d frames connected", turn + 1, motion.connected.sum(), len(before))
        if turn > 0 and np.array_equal(motion.connected, before):
            break
        with clock("backend"):
            estimate = estimate_motion(tracks, motion, config.backend, progress)
        motion = InitialMotion(pose_RG(tracks, estimate), motion.connected)
        yield Found(features, association, motion, tracks, estimate, links)


def polished(found: Found, images: Images, config: Config, progress: Progress, clock: Stopwatch) -> Found:
    """Landmarks joined, then put to the same place in every view: each step as long as it fits no worse."""
    for step in (_join_duplicates, _refine_places):
        with clock("frontend"):
            changed = step(found, images, config)
            if changed is None:
                continue
            tracks = images.tracks(*changed, config)
        try:
            with clock("backend"):
                again = estimate_motion(tracks, found.motion, config.backend, progress)
        except RunFailure as failure:
            _log.info("that leads to no motion and is not used: %s", failure)
            continue
        if contradicts(again, found.estimate):
            _log.info("that fits worse and is not used")
            continue
        motion = InitialMotion(pose_RG(tracks, again), found.motion.connected)
        found = replace(
            found,
            features=changed[0],
            association=changed[1],
            motion=motion,
            tracks=tracks,
            estimate=again,
        )
    return found


Changed = tuple[Sequence[StereoFeatures], Association]
Step = Callable[[Found, Images, Config], Changed | None]


def _join_duplicates(found: Found, images: Images, config: Config) -> Changed | None:
    """Landmarks that the motion shows to be one become one; None: there are none."""
    guided = config.frontend.guided
    if not guided.merge:
        return None
    known = found.association
    merged = merge_duplicates(found.features, known, found.motion, images.rectifier.rig, guided)
    joined = known.n_landmarks - merged.n_landmarks
    _log.info("%d of %d landmarks joined to others", joined, known.n_landmarks)
    return (found.features, merged) if joined else None


def _refine_places(found: Found, images: Images, config: Config) -> Changed | None:
    """Each landmark is put to the same point of the surface in every view; None: surfaces are not known."""
    if not config.frontend.tracks.refine or not any(seen.on_surface.any() for seen in found.features):
        return None
    return refine_tracks(
        *(images.sequence, images.rectifier, found.features, found.association, found.motion),
        *(config.frontend, workers(config)),
    )
