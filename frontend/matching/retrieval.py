"""Which pairs of frames are worth matching when a sequence is too long to try them all.

Every frame is summed up in one vector (VLAD: Jegou et al., "Aggregating local descriptors into a compact
image representation", 2010) over words learned from the sequence itself. A frame is matched with its
neighbours in time, where little has changed, and with the frames that look most like it, wherever they are:
the side that comes back after a revolution is recognised among thousands of frames, at a cost that grows
linearly.
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
LEARNED_FROM = 20_000
"""Descriptors of the whole sequence that the words are learned from."""
WORDS = 48
SAME_SIDE_DEG = 70.0
"""Frames whose directions of view in the body differ by more have little in common."""
CLOSE = 4
"""Frames so many apart are tried whatever the motion says."""
BLOCK = 512
"""Frames compared at a time."""


def pairs_to_match(frames: Sequence[StereoFeatures], config: PairMatching, seed: int) -> list[Ints]:
    """Per frame i the later frames j > i to match it with, ascending.

    All of them up to ``config.exhaustive_frames`` frames; of longer sequences the neighbours and those most
    alike.
    """
    n = len(frames)
    if n <= config.exhaustive_frames:
        return [np.arange(i + 1, n, dtype=np.int64) for i in range(n)]
    wanted = np.zeros((n, n), dtype=bool)
    for step in range(1, min(config.neighbours, n - 1) + 1):
        wanted[np.arange(n - step), np.arange(step, n)] = True
    for i, alike in enumerate(most_alike(frame_vectors(frames, seed), config.neighbours, config.retrieved)):
        wanted[np.minimum(i, alike), np.maximum(i, alike)] = True
    return [np.flatnonzero(wanted[i]).astype(np.int64) for i in range(n)]


def pairs_in_view(X_RG: Array, config: PairMatching) -> list[Ints]:
    """Per frame i the later frames j > i that see much the same side by the motion X_RG (F, 4, 4), ascending.

    All of them up to ``config.exhaustive_frames`` frames; of longer sequences the neighbours, and of the
    others those that see most of the same. Neighbours in time are tried even if the motion says otherwise.
    """
    n = len(X_RG)
    towards_G = inverse_pose(X_RG)[:, :3, 3]
    towards_G /= np.maximum(np.linalg.norm(towards_G, axis=1, keepdims=True), 1e-12)
    cosine = towards_G @ towards_G.T
    apart = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :])
    near = apart <= (CLOSE if n <= config.exhaustive_frames else config.neighbours)
    wanted = cosine > np.cos(np.deg2rad(SAME_SIDE_DEG))
    if n > config.exhaustive_frames:
        order = np.argsort(np.where(wanted & ~near, -cosine, np.inf), axis=1, kind="stable")
        best = np.zeros((n, n), dtype=bool)
        np.put_along_axis(best, order[:, : config.retrieved], True, axis=1)
        wanted &= best | best.T
    wanted |= near
    return [i + 1 + np.flatnonzero(wanted[i, i + 1 :]).astype(np.int64) for i in range(n)]


def frame_vectors(frames: Sequence[StereoFeatures], seed: int) -> Floats:
    """(F, WORDS d) one vector of unit length per frame; zeros where a frame has no features."""
    rng = np.random.default_rng(seed)
    described = [frame.descriptors for frame in frames if len(frame)]
    # a frame without features has descriptors of any width
    everything = np.concatenate(described or [frame.descriptors for frame in frames]).astype(np.float32)
    width = everything.shape[1]
    vectors = np.zeros((len(frames), WORDS * width), dtype=np.float32)
    if len(everything) < WORDS:
        return vectors
    sample = everything[rng.permutation(len(everything))[:LEARNED_FROM]]
    words, _ = kmeans2(sample, WORDS, iter=12, minit="++", rng=rng)
    for k, frame in enumerate(frames):
        if len(frame) == 0:
            continue
        nearest, _ = vq(frame.descriptors, words)
        residuals = np.zeros((WORDS, width), dtype=np.float32)
        np.add.at(residuals, nearest, frame.descriptors - words[nearest])
        # each word counts alike, however many features burst into it (Arandjelovic and Zisserman 2013)
        residuals /= np.maximum(np.linalg.norm(residuals, axis=1, keepdims=True), 1e-9)
        vectors[k] = residuals.ravel() / max(float(np.linalg.norm(residuals)), 1e-9)
    return vectors


def most_alike(vectors: Floats, neighbours: int, count: int) -> list[Ints]:
    """Per frame the ``count`` frames most alike, those within ``neighbours`` in time left out."""
    n, found = len(vectors), []
    for first in range(0, n, BLOCK):
        block = np.arange(first, min(first + BLOCK, n))
        similarity = vectors[block] @ vectors.T
        similarity[np.abs(block[:, None] - np.arange(n)[None, :]) <= neighbours] = -np.inf
        for row in similarity:
            best = np.argsort(-row, kind="stable")[:count]
            found.append(best[np.isfinite(row[best])].astype(np.int64))
    return found
