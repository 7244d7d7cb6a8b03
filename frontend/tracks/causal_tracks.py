"""Landmarks of a stream: each feature of a new frame gets its landmark when the frame arrives, for good.

A feature is of the landmark to which most of its matches in earlier frames belong, else of a new one.
Landmarks that turn out later to be the same point stay two: what was passed on cannot be taken back.
"""

from collections.abc import Sequence

import numpy as np

from polhode.frontend.matching.methods import one_to_one
from polhode.frontend.matching.pairs import PairMatch
from polhode.geometry.lie import Ints


class CausalTracks:
    """The landmark of each feature of the frames so far."""

    def __init__(self) -> None:
        self.landmark: list[Ints] = []
        """per frame (n,)"""
        self._next = 0

    def add(self, n_features: int, matches: Sequence[PairMatch]) -> Ints:
        """Landmarks (n_features,) of the next frame, each once.

        matches: with earlier frames; the new frame is the second one of each.
        """
        labels = np.full(n_features, -1, dtype=np.int64)
        votes = [
            np.stack([match.features[:, 1], self.landmark[match.i][match.features[:, 0]]], axis=1)
            for match in matches
        ]
        if votes:
            pairs, count = np.unique(np.concatenate(votes), axis=0, return_counts=True)
            # of equal votes the older landmark, whose number is smaller
            confidence = count - pairs[:, 1] / (self._next + 1.0)
            kept = pairs[one_to_one(pairs, confidence)]
            labels[kept[:, 0]] = kept[:, 1]
        new = labels < 0
        labels[new] = self._next + np.arange(new.sum())
        self._next += int(new.sum())
        self.landmark.append(labels)
        return labels

    def forget(self, frame: int) -> Ints:
        """The landmarks (n,) of a frame that will not be matched with any more."""
        labels, self.landmark[frame] = self.landmark[frame], np.zeros(0, dtype=np.int64)
        return labels
