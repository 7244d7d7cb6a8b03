"""Features of every frame, and the frames that match: without knowledge of the motion, or guided by it."""

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.backend import consistent_links, contrast_of_links, links_of_the_body, rotation_errors
from polhode.config.frontend_settings import Frontend
from polhode.files.record_files import digest_of
from polhode.frontend.extract import extract_features, extract_pair, require_weights
from polhode.frontend.features.methods import feature_method
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import with_patch_size
from polhode.frontend.matching.methods import HypothesisMethod, match_method
from polhode.frontend.matching.pairs import (
    PairMatch,
    combine_features,
    match_rows,
    offset_matches,
    pairs_in_view,
    pairs_to_match,
    relative_poses,
)
from polhode.frontend.rectification import RectifiedPair
from polhode.frontend.tracks.tracks import join_matches
from polhode.geometry.lie import Array, Bools, Ints
from polhode.pipeline.context import RunContext
from polhode.pipeline.runner import stage
from polhode.pipeline.stream_results import Streamed
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.runtime.errors import RunFailure

_log = logging.getLogger(__name__)
MAX_DIFFERENCE_RAD = np.deg2rad(15.0)
"""A match whose rotation differs by more from that of the known motion contradicts it."""


@dataclass(frozen=True)
class Correspondences:
    """Features of each frame, and those matches between frames that no others contradict."""

    features: Sequence[StereoFeatures]
    """Of each frame, F"""
    matches: Sequence[PairMatch]
    """Of each pair of frames i < j with enough matches that agree with one motion, sorted by (i, j)"""

    @property
    def links(self) -> RelativePoses:
        """The relative poses of the matched frames."""
        return relative_poses(self.matches)

    def require_features(self, least: int) -> None:
        """Raise RunFailure if fewer than three frames have at least so many features."""
        measured = sum(len(features) >= least for features in self.features)
        if measured < 3:
            raise RunFailure(
                f"only {measured} of {len(self.features)} frames show enough stereo features on the target; "
                "check exposure, focus and the calibration"
            )

    def tracks(self, context: RunContext) -> StereoTracks:
        """The tracks that follow from the matches alone, without knowledge of the motion."""
        return context.tracks(self.features, join_matches(self.features, self.matches))


def match_frames(context: RunContext) -> Correspondences:
    """Extract the features of every frame and match them, without a motion estimate."""
    return match_features(context, features_of_frames(context))


@stage("frontend", ["frontend"], is_stored=False)
def features_of_frames(context: RunContext, streamed: Streamed | None = None) -> list[StereoFeatures]:
    """The features of every pair, in order, by the first feature method, or those that a stream has found.

    Raises InputError at once, not after the work of the first method: weights that extraction, matching or,
    later, depth need are missing or wrong.
    """
    second = context.config.frontend.second_method
    if second is not None:
        feature_method(second), match_method(second)
    return _extract(context, context.config.frontend) if streamed is None else list(streamed.features)


def features_of_pair(context: RunContext, pair: RectifiedPair) -> StereoFeatures:
    """The features of one rectified pair, of the sequence or of the same cameras, by the first method."""
    return extract_pair(pair, context.rig, _with_patch_size(context, context.config.frontend))


@stage("frontend", ["frontend", "seed"], is_stored=False)
def match_features(
    context: RunContext, features: Sequence[StereoFeatures], streamed: Streamed | None = None
) -> Correspondences:
    """Match every frame with every other, or with those of similar appearance, without a motion estimate.

    features: of every frame, F. ``streamed``: what a stream has matched of them already.
    """
    config = context.config
    partners = pairs_to_match(features, config.frontend.pairs, config.seed)
    if streamed is None:
        matches = _match(context, features, partners, config.frontend)
    else:
        left = streamed.untried(partners)
        matches = streamed.with_found(_match(context, features, left, config.frontend))
    _, matches = _of_the_body(context, features, partners, matches, config.frontend)
    return _without_contradictions(context, features, matches)


def add_second_method(
    context: RunContext, first: Correspondences, second: Frontend, X_RG: Array | None
) -> Correspondences:
    """The correspondences of a second feature method together with those of the first.

    X_RG (F, 4, 4): poses of the target, which select the frames that see the same side; None: unknown, so
    that frames are paired by appearance.
    """
    features = _extract(context, second)
    partners = (
        pairs_to_match(features, second.pairs, context.config.seed)
        if X_RG is None
        else pairs_in_view(X_RG, second.pairs)
    )
    matches = _match(context, features, partners, second)
    known = list(first.matches)
    if X_RG is None:
        known, matches = _of_the_body(context, features, partners, matches, second, known)
    else:
        known, matches = _agreeing_with_motion(context, features, partners, matches, second, known, X_RG)
    both = combine_features(first.features, features)
    together = [*known, *offset_matches(matches, first.features)]
    return _without_contradictions(context, both, sorted(together, key=lambda m: (m.i, m.j)))


def _extract(context: RunContext, frontend: Frontend) -> list[StereoFeatures]:
    method, features = frontend.features.method, []
    with context.progress.stage(f"features ({method})", len(context.sequence)) as advance:
        for found in features_in_turn(context, frontend):
            features.append(found)
            advance()
    median = int(np.median([len(f) for f in features]))
    _log.info("stereo features (%s) per frame: median %d", method, median)
    return features


def features_in_turn(context: RunContext, frontend: Frontend) -> Iterator[StereoFeatures]:
    """The features of one pair after the other, few ahead of the caller.

    Raises InputError at once: weights that extraction, matching or, later, depth need are missing or wrong.
    """
    sequence, rectifier, stages = context.sequence, context.rectifier, context.stages
    require_weights(frontend)
    settings = _with_patch_size(context, frontend)
    # what the features of each pair depend on: its images, how they are rectified, the settings
    alike = digest_of(replace(rectifier, found=None), settings.with_digests)
    masks = {} if rectifier.found is None else rectifier.found.encoded
    keys = [stages.key(alike, sequence.digest_of_pair(k), masks.get(k)) for k in range(len(sequence))]
    return stages.each(
        "features",
        StereoFeatures,
        keys,
        lambda pairs: extract_features(sequence, rectifier, settings, context.workers, pairs),
    )


def _with_patch_size(context: RunContext, frontend: Frontend) -> Frontend:
    """What the features depend on, with the size of patches that the sequence calls for."""
    return with_patch_size(frontend.for_features, context.sequence, context.rectifier)


def _match(
    context: RunContext,
    features: Sequence[StereoFeatures],
    partners: Sequence[Ints],
    frontend: Frontend,
    hypotheses: int = 1,
) -> list[PairMatch]:
    rig, seed, workers, settings = context.rig, context.config.seed, context.workers, frontend.for_matching
    # what the matches of each frame depend on: its features and those of its partners
    known = [digest_of(each) for each in features]
    alike = digest_of(rig, settings.with_digests, seed, hypotheses)
    keys = [
        context.stages.key(alike, i, known[i], row, [known[j] for j in row.tolist()])
        for i, row in enumerate(partners)
    ]

    def compute(rows: list[int]) -> Iterable[list[PairMatch]]:
        return match_rows(features, partners, rig, settings, seed, workers, rows, hypotheses)

    matches: list[PairMatch] = []
    with context.progress.stage("matching frames", len(features)) as advance:
        for found in context.stages.each("matches", list[PairMatch], keys, compute):
            matches.extend(found)
            advance()
    pairs = {(match.i, match.j) for match in matches}
    _log.info("%d of %d pairs of frames matched", len(pairs), sum(map(len, partners)))
    return matches


def _of_the_body(
    context: RunContext,
    features: Sequence[StereoFeatures],
    partners: Sequence[Ints],
    matches: list[PairMatch],
    frontend: Frontend,
    first: Sequence[PairMatch] = (),
) -> tuple[list[PairMatch], list[PairMatch]]:
    """These matches, or those of other motions of the same frames, where what stands still hides the body.

    ``first``: matches of another method on the same frames, which are judged with them. Returned are those of
    them that are kept, and the matches.
    """
    count, unchanged = frontend.pairs.motions, (list(first), matches)
    if count == 1 or not isinstance(match_method(frontend), HypothesisMethod):
        return unchanged
    time_s, R_NR = context.time_s, context.X_NR[:, :3, :3]
    present = contrast_of_links(relative_poses([*first, *matches]), time_s, R_NR)
    # inliers of frames that show the same side over those of others; with less it may be the light's motion
    if present is not None and present >= 3.0:
        return unchanged
    several = _match(context, features, partners, frontend, count)
    chosen = links_of_the_body(relative_poses([*first, *several]), time_s, R_NR, present)
    _log.info(
        "frames that show the same side match hardly better than others%s: %s",
        "" if present is None else f" ({present:.1f} times)",
        "no other motion is clearer"
        if chosen is None
        else f"{np.sum(chosen)} links of another motion are used",
    )
    if chosen is None:
        return unchanged
    return _selected(first, chosen[: len(first)]), _selected(several, chosen[len(first) :])


def _agreeing_with_motion(
    context: RunContext,
    features: Sequence[StereoFeatures],
    partners: Sequence[Ints],
    matches: list[PairMatch],
    frontend: Frontend,
    first: list[PairMatch],
    X_RG: Array,
) -> tuple[list[PairMatch], list[PairMatch]]:
    """These matches, or those of other motions of the same frames if many contradict the poses (F, 4, 4).

    ``first``: matches of another method; returned are those that do not contradict the poses either.
    """
    count = frontend.pairs.motions
    off = rotation_errors(relative_poses(matches), X_RG) > MAX_DIFFERENCE_RAD
    few_off = np.sum(off) <= 0.3 * len(off)
    if count == 1 or few_off or not isinstance(match_method(frontend), HypothesisMethod):
        return first, matches
    several = _match(context, features, partners, frontend, count)
    error = rotation_errors(relative_poses(several), X_RG)
    nearest: dict[tuple[int, int], int] = {}
    for k in np.argsort(error, kind="stable").tolist():
        if error[k] < MAX_DIFFERENCE_RAD:
            nearest.setdefault((several[k].i, several[k].j), k)
    _log.info(
        "%.0f %% of the matched pairs contradict the motion; of several motions each, %d agree with it",
        *(100.0 * np.mean(off), len(nearest)),
    )
    agree = rotation_errors(relative_poses(first), X_RG) < MAX_DIFFERENCE_RAD
    return _selected(first, agree), [several[k] for k in sorted(nearest.values())]


def _without_contradictions(
    context: RunContext, features: Sequence[StereoFeatures], matches: Sequence[PairMatch]
) -> Correspondences:
    """Without the matches that contradict others."""
    good = consistent_links(relative_poses(matches), context.time_s, context.X_NR[:, :3, :3])
    _log.info("%d of %d matched pairs contradict others and are dropped", np.sum(~good), len(matches))
    return Correspondences(features, _selected(matches, good))


def _selected(matches: Sequence[PairMatch], good: Bools) -> list[PairMatch]:
    return [match for match, kept in zip(matches, good, strict=True) if kept]
