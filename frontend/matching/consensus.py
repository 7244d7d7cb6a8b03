"""Which matches agree on one motion: every match proposes one, since a feature knows its surface's axes.

A right match of two surface features gives the whole motion between the frames, roughly: the axes give the
rotation, the points the rest. Right matches propose alike motions; wrong ones scatter over all rotations, so
a handful of right ones among hundreds stand out (a vote in pose space, as in Ballard, "Generalizing the Hough
transform to detect arbitrary shapes", 1981). Distances between points, which no rotation changes, are
compared as well.
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array, transform_points
from polhode.records import Bools, Ints
from polhode.rigid_fit import fit_rigid

AXES_DEG = 25.0
"""Axes of right matches are off by 5 to 15 degrees; two proposals agree within this [deg]."""
SEEDS = 12
"""Proposals with the largest support that are refined."""
_SHRINK = (3.0, 2.0, 1.5, 1.0, 1.0)
"""Gates of the rounds of refinement, over the last one."""


@dataclass(frozen=True)
class Mode:
    """A motion and the matches that agree with it."""

    X_AB: Array
    """(4, 4)"""
    inlier: Bools
    """(m,)"""
    weight: float
    """Sum of the agreeing matches' weights"""


def motion_modes(
    p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array
) -> list[Mode]:
    """Motions that m matches support, strongest first; a match supports one of them.

    p_A, p_B (m, 3) [m] the points and R_AS, R_BS (m, 3, 3) the surfaces' axes in both frames; weight (m,);
    gate_m (m,) distance within which a moved point is the other [m].
    """
    if len(p_A) < 3:
        return []
    support = proposal_support(p_A, p_B, R_AS, R_BS, weight, gate_m)
    modes: list[Mode] = []
    waiting, free = support.total.copy(), np.ones(len(p_A), dtype=bool)
    for _ in range(min(SEEDS, len(p_A))):
        seed = int(waiting.argmax())
        if waiting[seed] <= 0.0:
            break
        waiting[seed] = 0.0
        mode = _refined(support.agrees[seed] & free, free, p_A, p_B, weight, gate_m)
        if mode is not None:
            modes.append(mode)
            # Those who agree would draw every other proposal to the same motion.
            free &= ~mode.inlier
            waiting[mode.inlier] = 0.0
    return sorted(modes, key=lambda mode: -mode.weight)


@dataclass(frozen=True)
class Support:
    """Who agrees with each match's proposal."""

    agrees: Bools
    """(m, m) symmetric"""
    total: Array
    """(m,) weight of those that agree, each counted by how well it is supported itself"""


def proposal_support(
    p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array
) -> Support:
    """Agreement between the motions that the matches propose; arguments as ``motion_modes``."""
    m = len(p_A)
    # Single precision: a millionth of the target's size.
    centre_A, centre_B = p_A.mean(axis=0), p_B.mean(axis=0)
    a, b = (p_A - centre_A).astype(np.float32), (p_B - centre_B).astype(np.float32)
    R = np.einsum("nij,nkj->nik", R_AS, R_BS).astype(np.float32)
    flat = R.reshape(m, 9)
    alike = flat @ flat.T > np.float32(1.0 + 2.0 * np.cos(np.deg2rad(AXES_DEG)))
    away_A, away_B = _distances(a), _distances(b)
    gate = np.add.outer(gate_m, gate_m).astype(np.float32)
    same_length = np.abs(away_A - away_B) < gate
    # Where the proposal of row n puts point k of frame B, relative to where frame A has it.
    moved = (R.reshape(3 * m, 3) @ b.T).reshape(m, 3, m)
    miss = moved - a.T[None] - (np.einsum("nij,nj->ni", R, b) - a)[:, :, None]
    reach = np.float32(2.0 * np.sin(np.deg2rad(AXES_DEG) / 2.0))
    hits = np.einsum("nik,nik->nk", miss, miss) < (reach * away_A + gate) ** 2
    agrees = alike & same_length & hits & hits.T
    pull = agrees.astype(np.float32) * weight.astype(np.float32)
    # Support that is itself supported from within: chance agreements have no friends in common.
    total = np.einsum("nk,nk->n", pull @ agrees.astype(np.float32), pull)
    return Support(agrees, total.astype(np.float64))


def _distances(p: np.ndarray[tuple[int, int], np.dtype[np.float32]]) -> Array:
    square = np.sum(p * p, axis=1)
    return np.asarray(np.sqrt(np.maximum(square[:, None] + square[None, :] - 2.0 * (p @ p.T), 0.0)))


def _refined(start: Bools, free: Bools, p_A: Array, p_B: Array, weight: Array, gate_m: Array) -> Mode | None:
    """Fit to those who agree, then to those free ones whom the fit puts within a gate that shrinks."""
    inlier = start
    for shrink in _SHRINK:
        if inlier.sum() < 3:
            return None
        X_AB = fit_rigid(p_A[inlier], p_B[inlier], weight[inlier] / gate_m[inlier] ** 2)
        miss = np.linalg.norm(p_A - transform_points(X_AB, p_B), axis=1)
        inlier = np.asarray((miss < shrink * gate_m) & free)
    return Mode(X_AB, inlier, float(weight[inlier].sum())) if inlier.sum() >= 3 else None


def one_to_one(pairs: Ints, confidence: Array) -> Ints:
    """Positions of the pairs (m, 2) to keep so that no feature has two: the surest first; ascending."""
    order = np.argsort(-confidence, kind="stable")
    used_a, used_b, kept = set[int](), set[int](), []
    for k in order.tolist():
        i, j = int(pairs[k, 0]), int(pairs[k, 1])
        if i not in used_a and j not in used_b:
            used_a.add(i)
            used_b.add(j)
            kept.append(k)
    return np.array(sorted(kept), dtype=np.int64)
