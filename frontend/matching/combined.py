"""What two methods see of the same frames, side by side: one localises better, the other finds more again.

Features of different methods are never the same landmark: their descriptors stand in blocks of their own, at
right angles to each other. Matches stay two links between the same frames, each with its own check.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import PairMatch
from polhode.lie import Array


def side_by_side(first: Sequence[StereoFeatures], second: Sequence[StereoFeatures]) -> list[StereoFeatures]:
    """Features of both methods in each frame, those of the first one first.

    What a method does not know of its features' surface is NaN.
    """
    width = _width(first), _width(second)
    return [_joined(a, b, width) for a, b in zip(first, second, strict=True)]


def _joined(a: StereoFeatures, b: StereoFeatures, width: tuple[int, int]) -> StereoFeatures:
    n = len(a)
    descriptors = np.zeros((n + len(b), sum(width)), dtype=np.float32)
    # a frame without features has descriptors of any width
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
    """Numbers in a descriptor of the method; 0 where it found nothing in any frame."""
    return max((frame.descriptors.shape[1] for frame in frames if len(frame)), default=0)


def _axes(features: StereoFeatures) -> Array:
    return np.full((len(features), 3, 3), np.nan) if features.R_RS is None else features.R_RS


def shifted(matches: Sequence[PairMatch], first: Sequence[StereoFeatures]) -> list[PairMatch]:
    """Matches of the second method, in the numbering of ``side_by_side``."""
    before = [len(features) for features in first]
    return [replace(m, features=m.features + np.array([before[m.i], before[m.j]])) for m in matches]


def of_second(match: PairMatch, first: Sequence[StereoFeatures]) -> bool:
    """Whether a match in the numbering of ``side_by_side`` is the second method's."""
    return bool(match.features[0, 0] >= len(first[match.i]))
