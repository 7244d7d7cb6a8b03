"""Matching of two frames by descriptors: mutual nearest neighbours, and dual softmax with a common motion.

The dual softmax considers more pairs than mutual nearest neighbours: where texture repeats, the second or
third best may be correct, and the common motion decides. See ``soft_assignment`` and ``consensus`` in this
package.
"""

import kornia.feature
import numpy as np
import torch

from polhode.config.frontend import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.consensus import MotionMode, motion_modes
from polhode.frontend.matching.methods import Matches, one_to_one
from polhode.frontend.matching.soft_assignment import DUSTBIN, TEMPERATURE, root_probabilities
from polhode.lie import Array, transform_points
from polhode.records import Bools, Ints

PROPOSING_PAIRS = 500
"""Number of the most probable pairs, which propose motions."""
CONSIDERED_PAIRS = 3000
"""Number of the most probable pairs, of which those that agree with the motion are kept."""
MIN_PROBABILITY = 1e-5
GATE_PX = 3.0
"""Largest distance in the image between a transformed point and its match [px]."""
GATE_DISPARITY_PX = 0.35
"""The same for disparity [px], whose errors dominate at short baselines."""
VOTE_EXPONENT = 0.25
"""Exponent of the probabilities as votes: many fair pairs count more than a few excellent ones."""
STATIC_PX = 4.0
"""Matches with a smaller displacement in the image are static [px]."""
_MAX_STATIC_SHARE = 0.6
_MIN_MOVING_INLIERS = 12
_MIN_MOVING_SHARE = 0.1


class MutualNearest:
    """``MatchMethod``: mutual nearest neighbours with a ratio test on both sides (Kornia's
    ``match_smnn``)."""

    def __init__(self, config: Frontend) -> None:
        self._ratio = config.pairs.ratio

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches; confidence: one minus the distance ratio, 0 where best and second best are the same."""
        if min(len(a), len(b)) < 2:
            return Matches.none()
        with torch.inference_mode():
            descriptors_a, descriptors_b = (torch.from_numpy(frame.descriptors) for frame in (a, b))
            ratio, index = kornia.feature.match_smnn(descriptors_a, descriptors_b, self._ratio)
        return Matches(index.numpy().astype(np.int64), 1.0 - ratio.numpy().ravel().astype(np.float64))


class SoftmaxMatcher:
    """``MatchMethod`` for features with known surface axes; others are matched by descriptors alone."""

    def __init__(self, config: Frontend) -> None:
        self._min_confidence = config.pairs.min_confidence

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches, at most one per feature; confidence: probability of the dual softmax."""
        if min(len(a), len(b)) < 2:
            return Matches.none()
        pairs, probability = self._probable(a, b)
        if a.R_RS is None or b.R_RS is None or a.metres_per_px is None:
            likely = probability >= self._min_confidence
            pairs, probability = pairs[likely], probability[likely]
        else:
            agrees = _agreeing(a, b, a.R_RS, b.R_RS, a.metres_per_px, pairs, probability)
            pairs, probability = pairs[agrees], probability[agrees]
        kept = one_to_one(pairs, probability)
        kept = kept[np.argsort(pairs[kept, 0])]
        return Matches(pairs[kept], probability[kept])

    def _probable(self, a: StereoFeatures, b: StereoFeatures) -> tuple[Ints, Array]:
        """The most probable pairs (m, 2), most probable first, and their probability (m,)."""
        descriptors = torch.from_numpy(a.descriptors), torch.from_numpy(b.descriptors)
        root = root_probabilities(*descriptors, TEMPERATURE, DUSTBIN).numpy()
        index = np.flatnonzero(root > np.sqrt(MIN_PROBABILITY))
        likely = root.ravel()[index]
        if len(index) > CONSIDERED_PAIRS:
            most = np.sort(np.argpartition(-likely, CONSIDERED_PAIRS)[:CONSIDERED_PAIRS])
            index, likely = index[most], likely[most]
        order = np.argsort(-likely, kind="stable")
        pairs = np.column_stack(np.divmod(index[order], root.shape[1]))
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
    """Whether each of the pairs (m, 2), most probable first, agrees with the motion that most pairs
    support."""
    i, j = pairs.T
    p_A, p_B = a.p_R[i], b.p_R[j]
    gate_m = np.maximum(GATE_PX * metres_per_px[i, 0], GATE_DISPARITY_PX * metres_per_px[i, 1])
    some = slice(0, PROPOSING_PAIRS)
    modes = motion_modes(
        p_A[some], p_B[some], R_AS[i[some]], R_BS[j[some]], probability[some] ** VOTE_EXPONENT, gate_m[some]
    )
    if not modes:
        return np.zeros(len(pairs), dtype=bool)
    displacement_px = np.linalg.norm(a.uvd_px[i[some], :2] - b.uvd_px[j[some], :2], axis=1)
    mode = _moving_mode(modes, displacement_px)
    miss = np.linalg.norm(p_A - transform_points(mode.X_AB, p_B), axis=1)
    return np.asarray(miss < gate_m)


def _moving_mode(modes: list[MotionMode], displacement_px: Array) -> MotionMode:
    """The motion with most support; another one if that is the zero motion of highlights and outlines.

    On a body that spins about its axis of symmetry, highlights, terminator and outlines are static in the
    image while the texture moves: most matches may agree on no motion at all. On a body that does not rotate
    nearly all matches are static, and no second motion has much support.
    """
    best = modes[0]
    if np.median(displacement_px[best.inlier]) >= STATIC_PX or np.mean(best.inlier) > _MAX_STATIC_SHARE:
        return best
    enough = max(_MIN_MOVING_INLIERS, _MIN_MOVING_SHARE * float(best.inlier.sum()))
    for other in modes[1:]:
        if other.inlier.sum() >= enough and np.median(displacement_px[other.inlier]) >= STATIC_PX:
            return other
    return best
