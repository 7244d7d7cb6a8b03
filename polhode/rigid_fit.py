"""Rotations and rigid transforms of least squares (Kabsch 1976), weighted where asked.

``frontend/matching/soft_assignment.py`` has a deliberate twin in torch, which can be differentiated.
"""

import numpy as np

from polhode.lie import Array, make_pose


def nearest_rotation(M: Array) -> Array:
    """Rotations R (..., 3, 3) that maximise trace(R^T M): for sum p q^T, the R with p ~ R q best."""
    U, _, Vt = np.linalg.svd(M)
    # A reflection fits noise on flat scenes better than a rotation: forbid it.
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)


def mean_rotation(R: Array) -> Array:
    """Chordal mean of rotations (F, 3, 3) -> (3, 3)."""
    return nearest_rotation(np.mean(R, axis=0))


def fit_rigid(p_A: Array, p_B: Array, weight: Array | None = None) -> Array:
    """X_AB (4, 4) that minimises sum w |p_A - X_AB p_B|^2 over points (n, 3), n >= 3, weights (n,)."""
    w = np.ones(len(p_A)) if weight is None else weight
    w = w / w.sum()
    mean_A, mean_B = w @ p_A, w @ p_B
    R = nearest_rotation((p_A - mean_A).T @ ((p_B - mean_B) * w[:, None]))
    return make_pose(R, mean_A - R @ mean_B)
