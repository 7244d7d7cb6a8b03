"""What two methods see of the same frames, side by side: one localises better, the other finds more again.

Features of different methods are never the same landmark: their descriptors stand in blocks of their own, at
right angles to each other. Matches stay two links between the same frames, each with its own check.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from frontend.pairs import PairMatch
from frontend.stereo import StereoFeatures


def side_by_side(first: StereoFeatures, second: StereoFeatures) -> StereoFeatures:
    """Features of both methods in one frame, those of the first one first.

    What one method does not know of its features is NaN.
    """
    n, m = len(first), len(second)
    a, b = first.descriptors, second.descriptors
    descriptors = np.zeros((n + m, a.shape[1] + b.shape[1]), dtype=np.float32)
    descriptors[:n, : a.shape[1]], descriptors[n:, a.shape[1] :] = a, b
    R_RS = None
    if first.R_RS is not None or second.R_RS is not None:
        R_RS = np.full((n + m, 3, 3), np.nan)
        for own, rows in ((first.R_RS, slice(0, n)), (second.R_RS, slice(n, n + m))):
            if own is not None:
                R_RS[rows] = own
    return StereoFeatures(
        np.concatenate([first.uvd_px, second.uvd_px]),
        np.concatenate([first.sigma_px, second.sigma_px]),
        np.concatenate([first.p_R, second.p_R]),
        np.concatenate([first.scale_px, second.scale_px]),
        descriptors,
        R_RS=R_RS,
    )


def shifted(matches: Sequence[PairMatch], first: Sequence[StereoFeatures]) -> list[PairMatch]:
    """Matches of the second method, in the numbering of ``side_by_side``."""
    before = [len(features) for features in first]
    return [replace(m, features=m.features + np.array([before[m.i], before[m.j]])) for m in matches]
