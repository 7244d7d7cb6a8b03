"""The method ``nearest``: descriptors of two frames that are each other's nearest neighbours, by far.

Descriptors are compared as whole numbers of eight bits: where the processor multiplies these, the products of
two frames take a quarter of the time, and they are exact, so that every processor finds the same. The way
back is searched only for features that are the nearest, by far, of another one.
"""

from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray

from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.stereo import COARSE_ROWS, CoarseDescriptors, StereoFeatures
from polhode.frontend.matching.matchers import SoftmaxMatcher
from polhode.frontend.matching.methods import Matches
from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled_reordered

Floats = NDArray[np.float32]
_LANES = COARSE_ROWS // 2
"""Neighbouring columns that are compared side by side, which the compiler turns into vector instructions."""


class MutualNearest:
    """``MatchMethod``: mutual nearest neighbours with a ratio test on both sides (Lowe 2004)."""

    def __init__(self, config: Frontend) -> None:
        self._ratio = config.pairs.ratio
        self._voting = SoftmaxMatcher(config)

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches; confidence: one minus the distance ratio, 0 where best and second best are the same."""
        if min(len(a), len(b)) < 2:
            return Matches.none()
        of_a, of_b = a.coarse_descriptors, b.coarse_descriptors
        nearest, ratio = _nearest(of_a, of_b, self._ratio)
        rows = np.flatnonzero(nearest >= 0)
        if len(rows) == 0:
            return Matches.none()
        wanted, position = np.unique(nearest[rows], return_inverse=True)
        back, ratio_back = _nearest(of_b.some(wanted), of_a, self._ratio)
        mutual = back[position] == rows
        worst = np.maximum(ratio[rows], ratio_back[position])[mutual]
        return Matches(np.column_stack([rows, nearest[rows]])[mutual], 1.0 - worst)

    def hypotheses(self, a: StereoFeatures, b: StereoFeatures, count: int) -> list[Matches]:
        """The matches of each of the ``count`` motions with most support, that one first: by the vote of all
        that may match (matchers.py). Without axes of the surface there is one motion."""
        if a.proposing_R_RS is None or b.proposing_R_RS is None:
            return [self(a, b)]
        return self._voting.hypotheses(a, b, count)


def _nearest(of: CoarseDescriptors, among: CoarseDescriptors, ratio: float) -> tuple[Ints, Array]:
    """For each descriptor (n,) its nearest one, -1 if the second is nearly as near; the distances' ratio."""
    smallest, index = _two_smallest(_products(of, among), of.square, among.square, ratio**2)
    return index, np.sqrt(smallest[0] / np.maximum(smallest[1], 1.0)).astype(np.float64)


@cache
def _multiplies_whole_numbers() -> bool:
    """Whether the processor has instructions for products of 8-bit numbers."""
    return bool(torch.backends.mkldnn.is_available() and torch.cpu._is_vnni_supported())


def _products(a: CoarseDescriptors, b: CoarseDescriptors) -> NDArray[np.int32]:
    """The exact products (n, m) of descriptors (n, d) and (m, d)."""
    if _multiplies_whole_numbers():
        with torch.inference_mode():
            product = torch._int_mm(torch.from_numpy(a.whole), torch.from_numpy(b.whole).T)
        return np.asarray(product.numpy())
    # below 2^24, so that single precision is exact
    return (a.whole.astype(np.float32) @ b.whole.astype(np.float32).T).astype(np.int32)


@compiled_reordered
def _two_smallest(
    product: NDArray[np.int32], square_a: Floats, square_b: Floats, ratio_square: float
) -> tuple[Floats, Ints]:
    """The two smallest squared distances in each row (2, n) of products (n, m), and where the first one is.

    -1: the ratio of both is larger than given, or the row is filled up.
    """
    n, m = product.shape
    far = np.float32(np.inf)
    smallest, index = np.ones((2, n), np.float32), np.full(n, -1)
    square = np.empty(m, np.float32)
    first, second = np.empty(_LANES, np.float32), np.empty(_LANES, np.float32)
    for i in range(n):
        own, row = square_a[i], product[i]
        if not own < far:
            break
        for j in range(m):
            square[j] = own + square_b[j] - np.float32(2.0) * np.float32(row[j])
        first[:] = far
        second[:] = far
        for start in range(0, m, _LANES):
            block = square[start : start + _LANES]
            for k in range(_LANES):
                s, f, g = block[k], first[k], second[k]
                larger = s if s > f else f
                second[k] = larger if larger < g else g
                first[k] = s if s < f else f
        f, g = far, far
        for k in range(_LANES):
            g = min(g, max(f, first[k]), second[k])
            f = min(f, first[k])
        smallest[0, i], smallest[1, i] = f, g
        if f <= ratio_square * g:
            j = 0
            while square[j] != f:
                j += 1
            index[i] = j
    return smallest, index
