"""Selection of the frame pairs to match when a sequence is too long to match all of them.

Every frame is represented by one vector (VLAD: Jegou et al., "Aggregating local descriptors into a compact
image representation", 2010) over a vocabulary of visual words learned from the sequence itself. A frame is
matched with its neighbours in time, where little has changed, and with the most similar frames of the whole
sequence: a side that is visible again after a revolution is recognised among thousands of frames, at a cost
that grows linearly.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2, vq

from polhode.config.frontend import PairMatching
from polhode.frontend.features.stereo import StereoFeatures
from polhode.lie import Array, inverse_pose
from polhode.records import Ints

Floats = NDArray[np.float32]
VOCABULARY_SAMPLE = 20_000
"""Number of descriptors of the whole sequence from which the visual words are learned."""
VOCABULARY_SIZE = 48
MAX_VIEW_ANGLE_DEG = 70.0
"""Frames whose viewing directions in the body differ by more have little in common."""
MAX_NEIGHBOUR_STEPS = 4
"""Frames up to this many steps apart are matched even if the motion predicts different views."""
BLOCK_FRAMES = 512
"""Frames that are compared at a time."""


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
    for i, similar in enumerate(
        most_similar(frame_vectors(frames, seed), config.neighbours, config.retrieved)
    ):
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
    sample = everything[rng.permutation(len(everything))[:VOCABULARY_SAMPLE]]
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
