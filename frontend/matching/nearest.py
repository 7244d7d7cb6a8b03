"""The method ``nearest``: descriptors of two frames that are each other's nearest neighbours, by far.

The similarities of all pairs are one product of matrices, by BLAS. One compiled pass over it keeps the two
largest of each row and of each column; which feature is the nearest is looked up only for those that pass
the test of the ratio.
"""

import numpy as np
from numpy.typing import NDArray

from polhode.compiled import compiled_reordered
from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.methods import Matches

Floats = NDArray[np.float32]
_LANES = 16
"""Neighbouring columns that are compared side by side, which the compiler turns into vector instructions."""
_NONE = -2.0
"""Less than every similarity."""


class MutualNearest:
    """``MatchMethod``: mutual nearest neighbours with a ratio test on both sides (Lowe 2004)."""

    def __init__(self, config: Frontend) -> None:
        self._ratio = config.pairs.ratio

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches; confidence: one minus the distance ratio, 0 where best and second best are the same."""
        if min(len(a), len(b)) < 2:
            return Matches.none()
        similarity = a.descriptors @ b.descriptors.T
        in_row, in_column = _two_largest(similarity)
        ratio_a, ratio_b = _distance_ratio(in_row), _distance_ratio(in_column)
        some = np.flatnonzero(ratio_a <= self._ratio)
        nearest = similarity[some].argmax(axis=1)
        mutual = (ratio_b[nearest] <= self._ratio) & (in_column[0, nearest] == in_row[0, some])
        pairs = np.column_stack([some, nearest])[mutual].astype(np.int64)
        ratio = np.maximum(ratio_a[pairs[:, 0]], ratio_b[pairs[:, 1]])
        return Matches(pairs, 1.0 - ratio.astype(np.float64))


def _distance_ratio(largest: Floats) -> Floats:
    """Ratios (n,) of the distances of nearest and second nearest, from their similarities (2, n)."""
    square = np.maximum(1.0 - largest, np.float32(1e-7))
    return np.asarray(np.sqrt(square[0] / square[1]), dtype=np.float32)


@compiled_reordered
def _two_largest(similarity: Floats) -> tuple[Floats, Floats]:
    """The two largest values of each row (2, n), and of each column (2, m), of a matrix (n, m)."""
    n, m = similarity.shape
    none = np.float32(_NONE)
    in_row, in_column = np.empty((2, n), np.float32), np.full((2, m), none)
    lanes = np.empty((2, _LANES), np.float32)
    whole = m - m % _LANES
    for i in range(n):
        row = similarity[i]
        lanes[:] = none
        for start in range(0, whole, _LANES):
            for k in range(_LANES):
                s = row[start + k]
                lanes[1, k] = max(lanes[1, k], min(lanes[0, k], s))
                lanes[0, k] = max(lanes[0, k], s)
        first, second = none, none
        for k in range(_LANES):
            second = max(second, min(first, lanes[0, k]), lanes[1, k])
            first = max(first, lanes[0, k])
        for j in range(whole, m):
            second = max(second, min(first, row[j]))
            first = max(first, row[j])
        in_row[0, i], in_row[1, i] = first, second
        for j in range(m):
            s = row[j]
            in_column[1, j] = max(in_column[1, j], min(in_column[0, j], s))
            in_column[0, j] = max(in_column[0, j], s)
    return in_row, in_column
