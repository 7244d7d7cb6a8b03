"""Our matcher: probable pairs by a dual softmax, and among them those that agree on one motion.

More pairs than mutual nearest neighbours are considered: where texture repeats, the second or third best is
the right one, and the motion tells. See ``frontend.soft_assignment`` and ``frontend.consensus``.
"""

import numpy as np
import torch

from polhode.config.frontend import Frontend
from polhode.frontend.features.methods import Matches
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.consensus import Mode, motion_modes, one_to_one
from polhode.frontend.matching.soft_assignment import DUSTBIN, TEMPERATURE, root_probabilities
from polhode.lie import Array, transform_points
from polhode.records import Bools, Ints

PROPOSING = 500
"""Most probable pairs, which propose motions."""
CONSIDERED = 3000
"""Most probable pairs, of which those are kept that agree with the motion."""
LEAST_PROBABILITY = 1e-5
GATE_PX = 3.0
"""Distance in the image within which a moved point is the other [px]."""
GATE_DISPARITY_PX = 0.35
"""The same for disparity [px]: at short baselines it is what scatters points."""
FLATTEN = 0.25
"""Power of the probabilities that makes votes: many fair pairs count more than a few excellent ones."""
STILL_PX = 4.0
"""Matches that move less stand still in the image [px]."""
_NEARLY_ALL = 0.6
_FEWEST = 12
_SHARE = 0.1


class SoftmaxMatcher:
    """``MatchMethod`` for features that know the axes of their surface; others are matched by looks alone."""

    def __init__(self, config: Frontend) -> None:
        self._least_confidence = config.pairs.min_confidence

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches, at most one a feature; confidence: probability of the dual softmax."""
        if min(len(a), len(b)) < 2:
            return Matches(np.zeros((0, 2), np.int64), np.zeros(0))
        pairs, probability = self._probable(a, b)
        if a.R_RS is None or b.R_RS is None or a.metres_per_px is None:
            likely = probability >= self._least_confidence
            pairs, probability = pairs[likely], probability[likely]
        else:
            agrees = _agreeing(a, b, a.R_RS, b.R_RS, a.metres_per_px, pairs, probability)
            pairs, probability = pairs[agrees], probability[agrees]
        kept = one_to_one(pairs, probability)
        kept = kept[np.argsort(pairs[kept, 0])]
        return Matches(pairs[kept], probability[kept])

    def _probable(self, a: StereoFeatures, b: StereoFeatures) -> tuple[Ints, Array]:
        """The most probable pairs (m, 2), surest first, and their probability (m,)."""
        looks = torch.from_numpy(a.descriptors), torch.from_numpy(b.descriptors)
        root = root_probabilities(*looks, TEMPERATURE, DUSTBIN).numpy()
        place = np.flatnonzero(root > np.sqrt(LEAST_PROBABILITY))
        likely = root.ravel()[place]
        if len(place) > CONSIDERED:
            most = np.sort(np.argpartition(-likely, CONSIDERED)[:CONSIDERED])
            place, likely = place[most], likely[most]
        order = np.argsort(-likely, kind="stable")
        pairs = np.column_stack(np.divmod(place[order], root.shape[1]))
        return pairs, likely[order].astype(np.float64) ** 2


def _agreeing(
    a: StereoFeatures,
    b: StereoFeatures,
    R_AS: Array,
    R_BS: Array,
    metres_per_px: Array,
    pairs: Ints,
    probability: Array,
) -> Bools:
    """Which of the pairs (m, 2), surest first, agree with the motion that most of the surest support."""
    i, j = pairs.T
    p_A, p_B = a.p_R[i], b.p_R[j]
    gate_m = np.maximum(GATE_PX * metres_per_px[i, 0], GATE_DISPARITY_PX * metres_per_px[i, 1])
    some = slice(0, PROPOSING)
    modes = motion_modes(
        p_A[some], p_B[some], R_AS[i[some]], R_BS[j[some]], probability[some] ** FLATTEN, gate_m[some]
    )
    if not modes:
        return np.zeros(len(pairs), dtype=bool)
    moves_px = np.linalg.norm(a.uvd_px[i[some], :2] - b.uvd_px[j[some], :2], axis=1)
    mode = _turning(modes, moves_px)
    miss = np.linalg.norm(p_A - transform_points(mode.X_AB, p_B), axis=1)
    return np.asarray(miss < gate_m)


def _turning(modes: list[Mode], moves_px: Array) -> Mode:
    """The strongest motion; another if the strongest is that of light and outlines, which stand still.

    On a body that spins about its axis of symmetry highlights, terminator, rims and rings stay where they are
    while the texture passes by: most matches agree on no motion at all. A body that does not turn has nearly
    all its matches at rest, and no second motion of any strength.
    """
    best = modes[0]
    if np.median(moves_px[best.inlier]) >= STILL_PX or np.mean(best.inlier) > _NEARLY_ALL:
        return best
    least = max(_FEWEST, _SHARE * float(best.inlier.sum()))
    for other in modes[1:]:
        if other.inlier.sum() >= least and np.median(moves_px[other.inlier]) >= STILL_PX:
            return other
    return best
