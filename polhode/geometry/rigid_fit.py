"""Least-squares rotations and rigid transforms (Kabsch 1976), optionally weighted.

``frontend/matching/matchers.py`` has a deliberate twin in torch, which can be differentiated.
"""

import numpy as np

from polhode.geometry.lie import Array, make_pose


def nearest_rotation(M: Array) -> Array:
    """Rotations R (..., 3, 3) that maximise trace(R^T M): for sum p q^T, the R with p ~ R q best."""
    U, _, Vt = np.linalg.svd(M)
    return _without_reflection(U, Vt, np.linalg.det(U @ Vt))


def mean_rotation(R: Array) -> Array:
    """Chordal mean of rotations (F, 3, 3) -> (3, 3)."""
    return nearest_rotation(np.mean(R, axis=0))


def fit_rigid(p_A: Array, p_B: Array, weight: Array | None = None) -> Array:
    """X_AB (4, 4) that minimises sum w |p_A - X_AB p_B|^2 over points (n, 3), n >= 3, weights (n,)."""
    if weight is None:
        mean_A, mean_B = p_A.mean(axis=0), p_B.mean(axis=0)
        R = nearest_rotation((p_A - mean_A).T @ (p_B - mean_B))
    else:
        w = weight / weight.sum()
        mean_A, mean_B = w @ p_A, w @ p_B
        U, _, Vt = np.linalg.svd((p_A - mean_A).T @ ((p_B - mean_B) * w[:, None]))
        # The rounded determinant: the last digit of stored matches depends on it.
        R = _without_reflection(U, Vt, np.sign(np.linalg.det(U @ Vt)))
    return make_pose(R, mean_A - R @ mean_B)


def _without_reflection(U: Array, Vt: Array, handedness: Array) -> Array:
    """U Vt, where a reflection (handedness -1) would fit noise on flat scenes better than a rotation does."""
    U = U.copy()
    U[..., :, 2] *= np.asarray(handedness)[..., None]
    return np.asarray(U @ Vt)
