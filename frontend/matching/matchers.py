"""The method ``polhode``: descriptors of two frames by dual softmax, with a common motion.

The dual softmax considers more pairs than mutual nearest neighbours: where texture repeats, the second or
third best may be correct, and the common motion decides. The probability of a match is the product of the
probabilities that each feature is the best match of the other (Rocco et al., "Neighbourhood consensus
networks", 2018; LoFTR, Sun et al. 2021). Features without a match are assigned to the dustbin (SuperGlue,
Sarlin et al. 2020). Softmax and rigid fit (Kabsch's, by SVD) are differentiable, so descriptors can be
trained for the motion (Wang and Solomon, "Deep closest point", 2019).

The common motion: every correct match of two surface features determines the motion between the frames
approximately: the surface axes give the rotation, the points the translation. Correct matches propose similar
motions, while wrong ones scatter over all rotations, so a handful of correct matches among hundreds is found
(voting in pose space, as in Ballard, "Generalizing the Hough transform to detect arbitrary shapes", 1981).
Axes of RootSIFT's key points are rougher, by the slopes of the disparity that the least squares estimate
beside it and the orientation of the key point, and serve the vote as well. Distances between
points, which are invariant to the motion, are compared too.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.methods import Matches, one_to_one
from polhode.geometry.lie import Array, Bools, Ints, make_pose, transform_points
from polhode.runtime.compiled import compiled_fused_ieee, compiled_reordered

Floats = NDArray[np.float32]
TEMPERATURE = 0.03
"""Divisor of the similarities."""
DUSTBIN = 0.6
"""Similarity to the dustbin."""
ROOTSIFT_TEMPERATURE, ROOTSIFT_DUSTBIN = 0.015, 0.8
"""The same of RootSIFT's descriptors, none of whose coordinates are negative: all are more alike."""
AXES_DEG = 25.0
"""Largest rotation between two proposals that agree [deg]; the axes have errors of 5 to 15 degrees."""
_SHRINK = (3.0, 2.0, 1.5, 1.0, 1.0)
"""Gates of the rounds of refinement, relative to the last one."""
PROPOSING_PAIRS = 500
"""Number of the most probable pairs, which propose motions."""
CONSIDERED_PAIRS = 3000
"""Number of the most probable pairs, of which those that agree with the motion are kept."""
MIN_PROBABILITY = 1e-5
EXCLUDED_SCORE = -1e4
"""Score of an excluded pair: finite, since infinite ones have no gradient."""
_ROWS = 128
"""Rows of similarities that are computed together."""
GATE_PX = 3.0
"""Largest distance in the image between a transformed point and its match [px]."""
GATE_DISPARITY_PX = 0.35
"""The same for disparity [px], whose errors dominate at short baselines."""
STATIC_PX = 4.0
"""Matches with a smaller displacement in the image are static [px]."""
_MAX_STATIC_SHARE = 0.6
_MIN_MOVING_INLIERS = 12
_MIN_MOVING_SHARE = 0.1


class DualSoftmax(nn.Module):
    """Descriptors (..., n, d) and (..., m, d) of unit length -> log probability (..., n, m) of each match;
    learns both constants."""

    def __init__(self, temperature: float = TEMPERATURE, dustbin: float = DUSTBIN) -> None:
        super().__init__()
        self.log_temperature = nn.Parameter(torch.tensor(temperature).log())
        self.dustbin = nn.Parameter(torch.tensor(dustbin))

    def forward(self, a: Tensor, b: Tensor, excluded: Tensor | None = None) -> Tensor:
        """Logarithm of the product of the probabilities in both directions.

        excluded (..., n, m): pairs that are not considered.
        """
        score = (a @ b.transpose(-1, -2)) * torch.exp(-self.log_temperature)
        if excluded is not None:
            score = score.masked_fill(excluded, EXCLUDED_SCORE)
        none = self.dustbin * torch.exp(-self.log_temperature)
        along_rows = torch.logaddexp(torch.logsumexp(score, dim=-1), none)
        along_columns = torch.logaddexp(torch.logsumexp(score, dim=-2), none)
        return 2.0 * score - along_rows[..., :, None] - along_columns[..., None, :]


def likely_pairs(a: Floats, b: Floats, temperature: float, dustbin: float) -> tuple[Ints, Floats]:
    """The pairs (m, 2), in the order of the first frame, whose probability by ``DualSoftmax`` is above
    ``MIN_PROBABILITY``, and the square root of that (m,).

    a (n, d), b (m, d) of unit length. Without a gradient, and several times as fast.
    """
    with torch.inference_mode():
        first, second = torch.from_numpy(a), torch.from_numpy(b).T
        sharpness = 1.0 / temperature
        root = torch.empty(len(a), len(b))
        columns = torch.full((len(b),), math.exp((dustbin - 1.0) * sharpness))
        rows = torch.full((len(a),), float(columns[0]))
        for start in range(0, len(a), _ROWS):
            # A block of rows stays in the processor's cache from the product to the sums.
            some = root[start : start + _ROWS]
            torch.addmm(
                torch.tensor(-sharpness), first[start : start + _ROWS], second, alpha=sharpness, out=some
            )
            some.exp_()
            rows[start : start + _ROWS] += some.sum(dim=1)
            columns += some.sum(dim=0)
        rows, columns = rows.sqrt_(), columns.sqrt_()
    return _above(root.numpy(), rows.numpy(), columns.numpy(), MIN_PROBABILITY**0.5)


@compiled_reordered
def _above(value: Floats, rows: Floats, columns: Floats, least: float) -> tuple[Ints, Floats]:
    """Pairs (m, 2) with value / (rows columns) above ``least``, and that quotient (m,)."""
    n, m = value.shape
    limit = np.float32(least) * columns
    counts = np.empty(n, np.int64)
    for i in range(n):
        own, row, count = rows[i], value[i], np.int32(0)
        for j in range(m):
            count += np.int32(row[j] > own * limit[j])
        counts[i] = count
    pairs, quotient = np.empty((counts.sum(), 2), np.int64), np.empty(counts.sum(), np.float32)
    k = 0
    for i in range(n):
        if counts[i] == 0:
            continue
        for j in range(m):
            if value[i, j] > rows[i] * limit[j]:
                pairs[k, 0], pairs[k, 1] = i, j
                quotient[k] = value[i, j] / (rows[i] * columns[j])
                k += 1
    return pairs, quotient


def rigid_fit(p_A: Tensor, p_B: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """R_AB (..., 3, 3) and t (..., 3) that minimise sum w |p_A - R p_B - t|^2 over points (..., n, 3).

    weight (..., n) >= 0. The points must not be collinear. This is the differentiable twin of
    ``polhode.geometry.rigid_fit.fit_rigid``; a test compares the two.
    """
    w = weight / weight.sum(dim=-1, keepdim=True)
    mean_A, mean_B = (torch.einsum("...n,...nk->...k", w, p) for p in (p_A, p_B))
    away_A, away_B = p_A - mean_A[..., None, :], p_B - mean_B[..., None, :]
    U, _, Vh = torch.linalg.svd(torch.einsum("...n,...ni,...nj->...ij", w, away_A, away_B))
    # On noisy planar points a reflection may fit better than a rotation: it is excluded.
    sign = torch.det(U @ Vh).detach().sign()
    flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], dim=-1)
    R = (U * flip[..., None, :]) @ Vh
    return R, mean_A - torch.einsum("...ij,...j->...i", R, mean_B)


@dataclass(frozen=True)
class MotionMode:
    """A motion between two frames, and the matches that agree with it."""

    X_AB: Array
    """(4, 4)"""
    inlier: Bools
    """(m,)"""
    weight: float
    """Sum of the agreeing matches' weights"""


def motion_modes(
    p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array
) -> list[MotionMode]:
    """Motions that the m matches support, strongest first; each match supports at most one of them.

    p_A, p_B (m, 3) [m]: points, and R_AS, R_BS (m, 3, 3): surface axes in both frames; weight (m,);
    gate_m (m,): largest distance between a transformed point and its match [m].
    """
    if len(p_A) < 3:
        return []
    agrees, support = _proposal_support(p_A, p_B, R_AS, R_BS, weight, gate_m)
    modes: list[MotionMode] = []
    waiting, free = support.copy(), np.ones(len(p_A), dtype=bool)
    # number of proposals, those with the largest support, that are refined
    for _ in range(min(12, len(p_A))):
        seed = int(waiting.argmax())
        if waiting[seed] <= 0.0:
            break
        waiting[seed] = 0.0
        R, t, inlier = _fit_in_rounds(agrees[seed] & free, free, p_A, p_B, weight, gate_m)
        if inlier.sum() >= 3:
            modes.append(MotionMode(make_pose(R, t), inlier, float(weight[inlier].sum())))
            # The agreeing matches would draw every other proposal to the same motion.
            free &= ~inlier
            waiting[inlier] = 0.0
    return sorted(modes, key=lambda mode: -mode.weight)


def _proposal_support(
    p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array
) -> tuple[Bools, Array]:
    """Agreement (m, m) between the motions that the matches propose, symmetric, and their support (m,).

    The support is the weight of the agreeing matches, each multiplied by its own support among them.
    Arguments as ``motion_modes``.
    """
    # Single precision is a millionth of the target's size.
    a, b = ((p - p.mean(axis=0)).astype(np.float32) for p in (p_A, p_B))
    R = np.einsum("nij,nkj->nik", R_AS, R_BS).astype(np.float32)
    flat = R.reshape(len(R), 9)
    agrees = _agreement(a, b, R, flat @ flat.T, gate_m.astype(np.float32))
    # Supporters are counted by their own support within the group, which chance agreements lack.
    # sum of the squared numbers of agreeing proposals up to which the pairs among them are gone through
    if np.sum(agrees.sum(axis=1) ** 2) < 2_000_000:
        return agrees, _listed_support(agrees, weight)
    pull = agrees.astype(np.float32) * weight.astype(np.float32)
    total = np.einsum("nk,nk->n", pull @ agrees.astype(np.float32), pull)
    return agrees, total.astype(np.float64)


@compiled_fused_ieee
def _listed_support(agrees: Bools, weight: Array) -> Array:
    """Support (m,) as a sum over pairs among those that agree with each: where few agree, less work."""
    m = len(agrees)
    total, supporters = np.zeros(m), np.empty(m, np.int64)
    for n in range(m):
        count = 0
        for k in range(m):
            if agrees[n, k]:
                supporters[count] = k
                count += 1
        for a in range(count):
            row, own = agrees[supporters[a]], weight[supporters[a]]
            for b in range(a):
                if row[supporters[b]]:
                    total[n] += 2.0 * own * weight[supporters[b]]
            total[n] += own * own
    return total


@compiled_fused_ieee
def _agreement(a: Floats, b: Floats, R: Floats, trace: Floats, gate_m: Floats) -> Bools:
    """Which proposals (m, m) agree: rotations, distances between the points, and places of each by the other.

    a, b (m, 3): points in the two frames; R (m, 3, 3): rotations; trace (m, m) of their differences.
    """
    m = len(a)
    agrees = np.zeros((m, m), dtype=np.bool_)
    alike = np.float32(1.0 + 2.0 * np.cos(np.deg2rad(AXES_DEG)))
    reach = np.float32(2.0 * np.sin(np.deg2rad(AXES_DEG) / 2.0))
    for n in range(m):
        agrees[n, n] = True
        for k in range(n):
            if not trace[n, k] > alike:
                continue
            gate = gate_m[n] + gate_m[k]
            away_A, away_B = np.float32(0.0), np.float32(0.0)
            miss, miss_back = np.float32(0.0), np.float32(0.0)
            for i in range(3):
                step = a[k, i] - a[n, i]
                turned, turned_back = np.float32(0.0), np.float32(0.0)
                for j in range(3):
                    apart = b[k, j] - b[n, j]
                    turned += R[n, i, j] * apart
                    turned_back += R[k, i, j] * apart
                away_A += step * step
                away_B += (b[k, i] - b[n, i]) ** 2
                miss += (turned - step) ** 2
                miss_back += (turned_back - step) ** 2
            away_A = np.sqrt(away_A)
            near = (reach * away_A + gate) ** 2
            if abs(away_A - np.sqrt(away_B)) < gate and miss < near and miss_back < near:
                agrees[n, k] = agrees[k, n] = True
    return agrees


@compiled_fused_ieee
def _fit_in_rounds(
    start: Bools, free: Bools, p_A: Array, p_B: Array, weight: Array, gate_m: Array
) -> tuple[Array, Array, Bools]:
    """Fit to the agreeing matches, then repeatedly to the free matches within a shrinking gate of the fit.

    Returns R (3, 3) and t (3,) of the last round, as ``polhode.geometry.rigid_fit``, and its inliers; none of
    these if a round has fewer than three.
    """
    inlier = start.copy()
    R, t = np.eye(3), np.zeros(3)
    for shrink in _SHRINK:
        if inlier.sum() < 3:
            return R, t, np.zeros_like(inlier)
        total = 0.0
        mean_A, mean_B = np.zeros(3), np.zeros(3)
        for n in range(len(inlier)):
            if inlier[n]:
                w = weight[n] / gate_m[n] ** 2
                total += w
                for i in range(3):
                    mean_A[i] += w * p_A[n, i]
                    mean_B[i] += w * p_B[n, i]
        mean_A /= total
        mean_B /= total
        M = np.zeros((3, 3))
        for n in range(len(inlier)):
            if inlier[n]:
                w = weight[n] / gate_m[n] ** 2
                for i in range(3):
                    for j in range(3):
                        M[i, j] += w * (p_A[n, i] - mean_A[i]) * (p_B[n, j] - mean_B[j])
        U, _, Vt = np.linalg.svd(M)
        if np.linalg.det(U @ Vt) < 0.0:
            U[:, 2] = -U[:, 2]
        R = U @ Vt
        t = mean_A - R @ mean_B
        for n in range(len(inlier)):
            square = 0.0
            for i in range(3):
                off = p_A[n, i] - t[i] - R[i, 0] * p_B[n, 0] - R[i, 1] * p_B[n, 1] - R[i, 2] * p_B[n, 2]
                square += off * off
            inlier[n] = free[n] and square < (shrink * gate_m[n]) ** 2
    return R, t, inlier


class SoftmaxMatcher:
    """``MatchMethod`` for features with known surface axes; others are matched by descriptors alone."""

    def __init__(self, config: Frontend) -> None:
        is_rootsift = config.features.method == "rootsift"
        self._min_confidence = config.pairs.min_confidence
        # Places of RootSIFT's unsure matches scatter by 1 px, of sure ones by 0.4, and no patch aligns them.
        self._least = self._min_confidence if is_rootsift else 0.0
        self._temperature = ROOTSIFT_TEMPERATURE if is_rootsift else TEMPERATURE
        self._dustbin = ROOTSIFT_DUSTBIN if is_rootsift else DUSTBIN

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches, at most one per feature; confidence: probability of the dual softmax."""
        if min(len(a), len(b)) < 2:
            return Matches.none()
        pairs, probability = self._probable(a, b)
        if a.proposing_R_RS is None or b.proposing_R_RS is None or a.metres_per_px is None:
            likely = probability >= self._min_confidence
            return _matches(pairs[likely], probability[likely])
        modes, gate_m = _modes(a, b, pairs, probability)
        if not modes:
            return Matches.none()
        i, j = pairs[:PROPOSING_PAIRS].T
        displacement_px = np.linalg.norm(a.uvd_px[i, :2] - b.uvd_px[j, :2], axis=1)
        sure = probability >= self._least
        mode = _moving_mode(modes, displacement_px)
        return _matches_of(mode, a, b, pairs[sure], probability[sure], gate_m[sure])

    def hypotheses(self, a: StereoFeatures, b: StereoFeatures, count: int) -> list[Matches]:
        """The matches of each of the ``count`` motions with most support, that one first.

        Improbable ones too: equal parts of a body share the probability.
        """
        R_AS, R_BS = a.proposing_R_RS, b.proposing_R_RS
        if R_AS is None or R_BS is None or a.metres_per_px is None or min(len(a), len(b)) < 2:
            return [self(a, b)]
        pairs, probability = self._probable(a, b)
        modes, gate_m = _modes(a, b, pairs, probability)
        return [_matches_of(mode, a, b, pairs, probability, gate_m) for mode in modes[:count]]

    def _probable(self, a: StereoFeatures, b: StereoFeatures) -> tuple[Ints, Array]:
        """The most probable pairs (m, 2), most probable first, and their probability (m,)."""
        pairs, likely = likely_pairs(a.descriptors, b.descriptors, self._temperature, self._dustbin)
        if len(pairs) > CONSIDERED_PAIRS:
            most = np.sort(np.argpartition(-likely, CONSIDERED_PAIRS)[:CONSIDERED_PAIRS])
            pairs, likely = pairs[most], likely[most]
        order = np.argsort(-likely, kind="stable")
        return pairs[order], likely[order].astype(np.float64) ** 2


def _matches(pairs: Ints, probability: Array) -> Matches:
    """One match per feature, ascending in the first frame."""
    kept = one_to_one(pairs, probability)
    kept = kept[np.argsort(pairs[kept, 0])]
    return Matches(pairs[kept], probability[kept])


def _modes(
    a: StereoFeatures, b: StereoFeatures, pairs: Ints, probability: Array
) -> tuple[list[MotionMode], Array]:
    """Motions that the most probable of the pairs (m, 2) support, and the gate (m,) [m] of each pair."""
    R_AS, R_BS, metres_per_px = a.proposing_R_RS, b.proposing_R_RS, a.metres_per_px
    # a method that estimates axes knows the scale, too
    assert R_AS is not None and R_BS is not None and metres_per_px is not None
    i, j = pairs.T
    gate_m = np.maximum(GATE_PX * metres_per_px[i, 0], GATE_DISPARITY_PX * metres_per_px[i, 1])
    some = slice(0, PROPOSING_PAIRS)
    i, j = i[some], j[some]
    # exponent of the probabilities as votes: many fair pairs count more than a few excellent ones
    weight = probability[some] ** 0.25
    return motion_modes(a.p_R[i], b.p_R[j], R_AS[i], R_BS[j], weight, gate_m[some]), gate_m


def _matches_of(
    mode: MotionMode, a: StereoFeatures, b: StereoFeatures, pairs: Ints, probability: Array, gate_m: Array
) -> Matches:
    """Those of the pairs (m, 2) that agree with a motion, within the gates (m,) [m]."""
    miss = np.linalg.norm(a.p_R[pairs[:, 0]] - transform_points(mode.X_AB, b.p_R[pairs[:, 1]]), axis=1)
    agrees = miss < gate_m
    return _matches(pairs[agrees], probability[agrees])


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
