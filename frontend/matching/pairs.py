"""Matching of frame pairs without prior motion: relative poses and inlier matches (thesis algorithm 2, lines
9-13).

Not only neighbours are matched: landmarks must be recognised after a revolution, since the inertia depends on
it, and other pairs bridge neighbours that cannot be matched. In sequences too long to match all pairs, every
frame is represented by one vector (VLAD: Jegou et al., "Aggregating local descriptors into a compact image
representation", 2010) over a vocabulary of visual words learned from the sequence itself. A frame is matched
with its neighbours in time, where little has changed, and with the most similar frames of the whole sequence:
a side that is visible again after a revolution is recognised among thousands of frames, at a cost that grows
linearly.

Features and matches of two methods on the same frames can be combined: one localises better, the other finds
more features again. Features of different methods are never the same landmark: their descriptors occupy
separate, orthogonal blocks. The matches of a frame pair remain two separate ``PairMatch``, each with its own
geometric check.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2, vq

from polhode.config.frontend_settings import Frontend, PairMatching
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.methods import HypothesisMethod, match_method
from polhode.frontend.matching.ransac import ransac_rigid
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, inverse_pose
from polhode.records.tracks import RelativePoses
from polhode.runtime.processes import in_order

Tick = Callable[[], None]
Floats = NDArray[np.float32]
MIN_INLIERS = 8
"""Pairs of frames with fewer inliers are no link."""
VOCABULARY_SIZE = 48
MAX_VIEW_ANGLE_DEG = 70.0
"""Frames whose viewing directions in the body differ by more have little in common."""
MAX_NEIGHBOUR_STEPS = 4
"""Frames up to this many steps apart are matched even if the motion predicts different views."""
BLOCK_FRAMES = 512
"""Frames that are compared at a time."""


@dataclass(frozen=True)
class PairMatch:
    """The motion between frames i < j, and the matches that agree with it."""

    i: int
    j: int
    """As ``i``, a position in the list of features that were matched"""
    X_RiRj: Array
    """(4, 4) p_Ri = X_RiRj p_Rj for a point of the target in the left cameras; translation [m]"""
    features: Ints
    """(m, 2) indices into the features of i and of j"""

    def __len__(self) -> int:
        """Number of matches, m."""
        return len(self.features)


def match_pairs(
    frames: Sequence[StereoFeatures],
    partners: Sequence[Ints],
    rig: RectifiedRig,
    config: Frontend,
    seed: int,
    workers: int,
    tick: Tick,
) -> list[PairMatch]:
    """Matches that pass the geometric check, sorted by (i, j).

    partners: for each frame i, the frames j > i to match it with. ``tick`` is called once per frame i. The
    random numbers of a pair depend on (seed, i, j) only, so the result does not depend on the number of
    workers.
    """
    matches: list[PairMatch] = []
    for found in match_rows(frames, partners, rig, config, seed, workers, range(len(frames))):
        matches.extend(found)
        tick()
    return matches


def match_rows(
    frames: Sequence[StereoFeatures],
    partners: Sequence[Ints],
    rig: RectifiedRig,
    config: Frontend,
    seed: int,
    workers: int,
    rows: Sequence[int],
    hypotheses: int = 1,
) -> Iterator[list[PairMatch]]:
    """The same for some frames i, the matches of each in its turn; up to so many ``hypotheses`` for each pair
    of frames, each with its own motion."""
    return in_order(partial(_match_row, frames, partners, rig, config, seed, hypotheses), rows, workers)


def _match_row(
    frames: Sequence[StereoFeatures] | Mapping[int, StereoFeatures],
    partners: Sequence[Ints] | Mapping[int, Ints],
    rig: RectifiedRig,
    config: Frontend,
    seed: int,
    hypotheses: int,
    i: int,
) -> list[PairMatch]:
    """Matches of frame i with its partners, for each of several motions, that pass the geometric check."""
    method, found = match_method(config), list[PairMatch]()
    for j in partners[i].tolist():
        if min(len(frames[i]), len(frames[j])) < MIN_INLIERS:
            continue
        if hypotheses > 1 and isinstance(method, HypothesisMethod):
            candidates = method.hypotheses(frames[i], frames[j], hypotheses)
        else:
            candidates = [method(frames[i], frames[j])]
        rng = np.random.default_rng([seed, i, j])
        for pairs in (candidate.features for candidate in candidates):
            if len(pairs) < MIN_INLIERS:
                continue
            a, b = pairs.T
            fit = ransac_rigid(frames[i].uvd_px[a], frames[i].p_R[a], frames[j].p_R[b], rig, rng)
            if fit.inlier.sum() >= MIN_INLIERS:
                found.append(PairMatch(i, j, fit.X_RiRj, pairs[fit.inlier]))
    return found


def match_pair(
    frames: Sequence[StereoFeatures] | Mapping[int, StereoFeatures],
    i: int,
    j: int,
    rig: RectifiedRig,
    config: Frontend,
    seed: int,
) -> PairMatch | None:
    """The match of frames i < j; None: it does not pass the geometric check.

    It depends on these two frames and (seed, i, j) only, whenever it is made.
    """
    return next(iter(_match_row(frames, {i: np.array([j])}, rig, config, seed, 1, i)), None)


def relative_poses(matches: Sequence[PairMatch]) -> RelativePoses:
    """The relative poses of the matched pairs, for the back end."""
    return RelativePoses(
        i=np.array([m.i for m in matches], dtype=np.int64),
        j=np.array([m.j for m in matches], dtype=np.int64),
        X_RiRj=np.array([m.X_RiRj for m in matches]).reshape(-1, 4, 4),
        inliers=np.array([len(m.features) for m in matches], dtype=np.int64),
    )


def pairs_to_match(frames: Sequence[StereoFeatures], config: PairMatching, seed: int) -> list[Ints]:
    """For each frame i, the later frames j > i to match it with, ascending.

    All of them up to ``config.exhaustive_frames`` frames; in longer sequences, the neighbours and the most
    similar frames.
    """
    n = len(frames)
    if n <= config.exhaustive_frames:
        return [np.arange(i + 1, n, dtype=np.int64) for i in range(n)]
    wanted = np.zeros((n, n), dtype=bool)
    for step in range(1, min(config.neighbours, n - 1) + 1):
        wanted[np.arange(n - step), np.arange(step, n)] = True
    vectors = frame_vectors(frames, seed)
    for i, similar in enumerate(most_similar(vectors, config.neighbours, config.retrieved)):
        wanted[np.minimum(i, similar), np.maximum(i, similar)] = True
    return [np.flatnonzero(wanted[i]).astype(np.int64) for i in range(n)]


def pairs_in_view(X_RG: Array, config: PairMatching) -> list[Ints]:
    """For each frame i, the later frames j > i with similar views by the motion X_RG (F, 4, 4), ascending.

    All of them up to ``config.exhaustive_frames`` frames; in longer sequences, the neighbours and the frames
    with the most similar viewing directions. Neighbours in time are included even if the motion predicts
    other views.
    """
    n = len(X_RG)
    view_G = inverse_pose(X_RG)[:, :3, 3]
    view_G /= np.maximum(np.linalg.norm(view_G, axis=1, keepdims=True), 1e-12)
    cosine = view_G @ view_G.T
    steps = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :])
    near = steps <= (MAX_NEIGHBOUR_STEPS if n <= config.exhaustive_frames else config.neighbours)
    wanted = cosine > np.cos(np.deg2rad(MAX_VIEW_ANGLE_DEG))
    if n > config.exhaustive_frames:
        order = np.argsort(np.where(wanted & ~near, -cosine, np.inf), axis=1, kind="stable")
        best = np.zeros((n, n), dtype=bool)
        np.put_along_axis(best, order[:, : config.retrieved], True, axis=1)
        wanted &= best | best.T
    wanted |= near
    return [i + 1 + np.flatnonzero(wanted[i, i + 1 :]).astype(np.int64) for i in range(n)]


def frame_vectors(frames: Sequence[StereoFeatures], seed: int) -> Floats:
    """(F, VOCABULARY_SIZE d) one vector of unit length per frame; zeros where a frame has no features."""
    rng = np.random.default_rng(seed)
    described = [frame.descriptors for frame in frames if len(frame)]
    # A frame without features has descriptors of arbitrary width.
    everything = np.concatenate(described or [frame.descriptors for frame in frames]).astype(np.float32)
    width = everything.shape[1]
    vectors = np.zeros((len(frames), VOCABULARY_SIZE * width), dtype=np.float32)
    if len(everything) < VOCABULARY_SIZE:
        return vectors
    # number of descriptors of the whole sequence from which the visual words are learned
    sample = everything[rng.permutation(len(everything))[:20_000]]
    words, _ = kmeans2(sample, VOCABULARY_SIZE, iter=12, minit="++", rng=rng)
    for k, frame in enumerate(frames):
        if len(frame) == 0:
            continue
        nearest, _ = vq(frame.descriptors, words)
        residuals = np.zeros((VOCABULARY_SIZE, width), dtype=np.float32)
        np.add.at(residuals, nearest, frame.descriptors - words[nearest])
        # Each word has equal weight, however many features it has (Arandjelovic and Zisserman 2013).
        residuals /= np.maximum(np.linalg.norm(residuals, axis=1, keepdims=True), 1e-9)
        vectors[k] = residuals.ravel() / max(float(np.linalg.norm(residuals)), 1e-9)
    return vectors


def most_similar(vectors: Floats, neighbours: int, count: int) -> list[Ints]:
    """For each frame the ``count`` most similar frames, without those within ``neighbours`` steps in time."""
    n, found = len(vectors), []
    for first in range(0, n, BLOCK_FRAMES):
        block = np.arange(first, min(first + BLOCK_FRAMES, n))
        similarity = vectors[block] @ vectors.T
        similarity[np.abs(block[:, None] - np.arange(n)[None, :]) <= neighbours] = -np.inf
        for row in similarity:
            best = np.argsort(-row, kind="stable")[:count]
            found.append(best[np.isfinite(row[best])].astype(np.int64))
    return found


def combine_features(
    first: Sequence[StereoFeatures], second: Sequence[StereoFeatures]
) -> list[StereoFeatures]:
    """Features of both methods in each frame, those of the first method first.

    Surface axes are NaN for a method that does not estimate them.
    """
    # A frame without features has descriptors of arbitrary width.
    width, wider = (
        max((frame.descriptors.shape[1] for frame in frames if len(frame)), default=0)
        for frames in (first, second)
    )
    combined = []
    for a, b in zip(first, second, strict=True):
        descriptors = np.zeros((len(a) + len(b), width + wider), dtype=np.float32)
        if len(a):
            descriptors[: len(a), :width] = a.descriptors
        if len(b):
            descriptors[len(a) :, width:] = b.descriptors
        R_RS = [np.full((len(f), 3, 3), np.nan) if f.R_RS is None else f.R_RS for f in (a, b)]
        combined.append(
            StereoFeatures(
                np.concatenate([a.uvd_px, b.uvd_px]),
                np.concatenate([a.sigma_px, b.sigma_px]),
                np.concatenate([a.p_R, b.p_R]),
                np.concatenate([a.scale_px, b.scale_px]),
                descriptors,
                R_RS=np.concatenate(R_RS),
            )
        )
    return combined


def offset_matches(matches: Sequence[PairMatch], first: Sequence[StereoFeatures]) -> list[PairMatch]:
    """Matches of the second method, with the indices of ``combine_features``."""
    before = [len(features) for features in first]
    return [replace(m, features=m.features + np.array([before[m.i], before[m.j]])) for m in matches]


def is_from_second(match: PairMatch, first: Sequence[StereoFeatures]) -> bool:
    """Whether a match with the indices of ``combine_features`` is from the second method."""
    return bool(match.features[0, 0] >= len(first[match.i]))
