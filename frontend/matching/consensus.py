"""Motions between two frames on which many matches of surface features agree.

Every correct match of two surface features determines the motion between the frames approximately: the
surface axes give the rotation, the points the translation. Correct matches propose similar motions, while
wrong ones scatter over all rotations, so a handful of correct matches among hundreds is found (voting in pose
space, as in Ballard, "Generalizing the Hough transform to detect arbitrary shapes", 1981). Distances between
points, which are invariant to the motion, are compared as well.
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array, transform_points
from polhode.records import Bools
from polhode.rigid_fit import fit_rigid

AXES_DEG = 25.0
"""Largest rotation between two proposals that agree [deg]; the axes have errors of 5 to 15 degrees."""
SEEDS = 12
"""Number of proposals, those with the largest support, that are refined."""
_SHRINK = (3.0, 2.0, 1.5, 1.0, 1.0)
"""Gates of the rounds of refinement, relative to the last one."""


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
    support = _proposal_support(p_A, p_B, R_AS, R_BS, weight, gate_m)
    modes: list[MotionMode] = []
    waiting, free = support.total.copy(), np.ones(len(p_A), dtype=bool)
    for _ in range(min(SEEDS, len(p_A))):
        seed = int(waiting.argmax())
        if waiting[seed] <= 0.0:
            break
        waiting[seed] = 0.0
        mode = _refined(support.agrees[seed] & free, free, p_A, p_B, weight, gate_m)
        if mode is not None:
            modes.append(mode)
            # The agreeing matches would draw every other proposal to the same motion.
            free &= ~mode.inlier
            waiting[mode.inlier] = 0.0
    return sorted(modes, key=lambda mode: -mode.weight)


@dataclass(frozen=True)
class _Support:
    """Agreement with the proposal of each match."""

    agrees: Bools
    """(m, m) symmetric"""
    total: Array
    """(m,) weight of the agreeing matches, each multiplied by its own support among them"""


def _proposal_support(
    p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array
) -> _Support:
    """Agreement between the motions that the matches propose; arguments as ``motion_modes``."""
    m = len(p_A)
    # Single precision is a millionth of the target's size.
    centre_A, centre_B = p_A.mean(axis=0), p_B.mean(axis=0)
    a, b = (p_A - centre_A).astype(np.float32), (p_B - centre_B).astype(np.float32)
    R = np.einsum("nij,nkj->nik", R_AS, R_BS).astype(np.float32)
    flat = R.reshape(m, 9)
    alike = flat @ flat.T > np.float32(1.0 + 2.0 * np.cos(np.deg2rad(AXES_DEG)))
    away_A, away_B = _distances(a), _distances(b)
    gate = np.add.outer(gate_m, gate_m).astype(np.float32)
    same_length = np.abs(away_A - away_B) < gate
    # Position of point k of frame B by the proposal of match n, relative to its position in frame A.
    moved = (R.reshape(3 * m, 3) @ b.T).reshape(m, 3, m)
    miss = moved - a.T[None] - (np.einsum("nij,nj->ni", R, b) - a)[:, :, None]
    reach = np.float32(2.0 * np.sin(np.deg2rad(AXES_DEG) / 2.0))
    hits = np.einsum("nik,nik->nk", miss, miss) < (reach * away_A + gate) ** 2
    agrees = alike & same_length & hits & hits.T
    pull = agrees.astype(np.float32) * weight.astype(np.float32)
    # Supporters are counted by their own support within the group, which chance agreements lack.
    total = np.einsum("nk,nk->n", pull @ agrees.astype(np.float32), pull)
    return _Support(agrees, total.astype(np.float64))


def _distances(p: np.ndarray[tuple[int, int], np.dtype[np.float32]]) -> Array:
    square = np.sum(p * p, axis=1)
    return np.asarray(np.sqrt(np.maximum(square[:, None] + square[None, :] - 2.0 * (p @ p.T), 0.0)))


def _refined(
    start: Bools, free: Bools, p_A: Array, p_B: Array, weight: Array, gate_m: Array
) -> MotionMode | None:
    """Fit to the agreeing matches, then repeatedly to the free matches within a shrinking gate of the fit."""
    inlier = start
    for shrink in _SHRINK:
        if inlier.sum() < 3:
            return None
        X_AB = fit_rigid(p_A[inlier], p_B[inlier], weight[inlier] / gate_m[inlier] ** 2)
        miss = np.linalg.norm(p_A - transform_points(X_AB, p_B), axis=1)
        inlier = np.asarray((miss < shrink * gate_m) & free)
    return MotionMode(X_AB, inlier, float(weight[inlier].sum())) if inlier.sum() >= 3 else None
