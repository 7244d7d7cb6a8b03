"""Relative poses between frames by absolute orientation of the landmarks that they share."""

import numpy as np

from polhode.compiled import compiled
from polhode.lie import Array, make_pose
from polhode.records import Ints
from polhode.rigid_fit import nearest_rotation


def pair_poses(
    frame: Ints, point: Ints, p_R: Array, X_RG: Array, gate_m: float, least: int
) -> tuple[Ints, Ints, Array, Ints]:
    """i, j (E,), X_RiRj (E, 4, 4), landmarks used (E,): of all pairs with at least ``least`` landmarks.

    Observations (M,) of points p_R (M, 3) [m], at most one of each point per frame; X_RG (F, 4, 4) true
    poses. Observations farther than the gate from their true position are left out. X by least squares
    (Kabsch 1976).
    """
    index = np.full((len(X_RG), int(point.max(initial=0)) + 1), -1, dtype=np.int64)
    index[frame, point] = np.arange(len(frame))
    i, j = np.triu_indices(len(X_RG), 1)
    centres, spread, count = _sums(index, i, j, np.ascontiguousarray(p_R), X_RG, gate_m)
    use = count >= least
    i, j, centres, count = i[use], j[use], centres[use], count[use]
    R = nearest_rotation(spread[use])
    return i, j, make_pose(R, centres[:, 0] - np.einsum("eab,eb->ea", R, centres[:, 1])), count


@compiled
def _sums(index: Ints, i: Ints, j: Ints, p_R: Array, X_RG: Array, gate_m: float) -> tuple[Array, Array, Ints]:
    """Centres (E, 2, 3) in both frames, products about them (E, 3, 3), numbers (E,) of good landmarks."""
    n = len(i)
    centres, spread, count = np.zeros((n, 2, 3)), np.zeros((n, 3, 3)), np.zeros(n, dtype=np.int64)
    chosen, q = np.empty((index.shape[1], 2), dtype=np.int64), np.empty(3)
    for e in range(n):
        A, B, found = X_RG[i[e]], X_RG[j[e]], 0
        for mark in range(index.shape[1]):
            a, b = index[i[e], mark], index[j[e], mark]
            if a < 0 or b < 0:
                continue
            # p_i against A B^-1 p_j
            for c in range(3):
                q[c] = 0.0
                for r in range(3):
                    q[c] += B[r, c] * (p_R[b, r] - B[r, 3])
            square = 0.0
            for r in range(3):
                square += (p_R[a, r] - A[r, 0] * q[0] - A[r, 1] * q[1] - A[r, 2] * q[2] - A[r, 3]) ** 2
            if square < gate_m**2:
                chosen[found, 0], chosen[found, 1] = a, b
                found += 1
        count[e] = found
        for m in range(found):
            for r in range(3):
                centres[e, 0, r] += p_R[chosen[m, 0], r] / found
                centres[e, 1, r] += p_R[chosen[m, 1], r] / found
        for m in range(found):
            for r in range(3):
                for c in range(3):
                    spread[e, r, c] += (p_R[chosen[m, 0], r] - centres[e, 0, r]) * (
                        p_R[chosen[m, 1], c] - centres[e, 1, c]
                    )
    return centres, spread, count
