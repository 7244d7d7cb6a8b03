"""Combination of the features and matches of two methods on the same frames.

One method localises better, the other finds more features again. Features of different methods are never the
same landmark: their descriptors occupy separate, orthogonal blocks. The matches of a frame pair remain two
separate ``PairMatch``, each with its own geometric check.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import PairMatch
from polhode.lie import Array


def combine_features(
    first: Sequence[StereoFeatures], second: Sequence[StereoFeatures]
) -> list[StereoFeatures]:
    """Features of both methods in each frame, those of the first method first.

    Surface axes are NaN for a method that does not estimate them.
    """
    width = _width(first), _width(second)
    return [_joined(a, b, width) for a, b in zip(first, second, strict=True)]


def offset_matches(matches: Sequence[PairMatch], first: Sequence[StereoFeatures]) -> list[PairMatch]:
    """Matches of the second method, with the indices of ``combine_features``."""
    before = [len(features) for features in first]
    return [replace(m, features=m.features + np.array([before[m.i], before[m.j]])) for m in matches]


def is_from_second(match: PairMatch, first: Sequence[StereoFeatures]) -> bool:
    """Whether a match with the indices of ``combine_features`` is from the second method."""
    return bool(match.features[0, 0] >= len(first[match.i]))


def _joined(a: StereoFeatures, b: StereoFeatures, width: tuple[int, int]) -> StereoFeatures:
    n = len(a)
    descriptors = np.zeros((n + len(b), sum(width)), dtype=np.float32)
    # A frame without features has descriptors of arbitrary width.
    if n:
        descriptors[:n, : width[0]] = a.descriptors
    if len(b):
        descriptors[n:, width[0] :] = b.descriptors
    return StereoFeatures(
        np.concatenate([a.uvd_px, b.uvd_px]),
        np.concatenate([a.sigma_px, b.sigma_px]),
        np.concatenate([a.p_R, b.p_R]),
        np.concatenate([a.scale_px, b.scale_px]),
        descriptors,
        R_RS=np.concatenate([_axes(a), _axes(b)]),
    )


def _width(frames: Sequence[StereoFeatures]) -> int:
    """Length of the descriptors of a method; 0 if it found no features in any frame."""
    return max((frame.descriptors.shape[1] for frame in frames if len(frame)), default=0)


def _axes(features: StereoFeatures) -> Array:
    return np.full((len(features), 3, 3), np.nan) if features.R_RS is None else features.R_RS
