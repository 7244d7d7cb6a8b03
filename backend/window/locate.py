"""Where a new frame is: by the prediction when its observations agree with it, else by the map."""

from dataclasses import dataclass

import numpy as np

from polhode.backend.initialization.initialize import ransac_orientation
from polhode.camera import RectifiedRig
from polhode.lie import Array, exp_so3, hat
from polhode.records import Bools

ARRIVAL_GATE = 5.0
"""Largest norm of a residual, whitened by its own noise and the landmark's, of what is let in."""
ENOUGH = 0.6
"""Share of the observations of known landmarks that must agree with a pose."""
LEAST_ENOUGH = 0.4
"""The same for a pose found by the map: 30 % gross errors, and landmarks that are wrong themselves."""
LEAST_COMMON = 5
REFINEMENTS = 3


@dataclass(frozen=True)
class Known:
    """Observations of landmarks whose position is known."""

    uvd_px: Array
    """(m, 3)"""
    inv_sigma: Array
    """(m, 3)"""
    p_G: Array
    """(m, 3)"""
    covariance: Array
    """(m, 3, 3)"""


@dataclass(frozen=True)
class Located:
    """The pose of a frame and which of its observations of known landmarks agree."""

    X_RG: Array
    """(4, 4)"""
    agree: Bools
    """(m,)"""
    by: str
    """prediction, map, or nothing"""


def locate(rig: RectifiedRig, known: Known, guess: Array | None, seed: int) -> Located:
    """Pose X_RG from a guess (None: there is none) and the observations of known landmarks."""
    m = len(known.p_G)
    if guess is not None:
        X = guess
        agree = agreement(rig, known, X)
        if agree.sum() >= max(LEAST_COMMON, ENOUGH * m):
            return Located(X, agree, "prediction")
        if agree.sum() >= max(LEAST_COMMON, 0.3 * m):
            X, agree = refine(rig, known, X, agree)
            if agree.sum() >= max(LEAST_COMMON, ENOUGH * m):
                return Located(X, agree, "prediction")
    if m >= LEAST_COMMON:
        p_R = rig.triangulate(known.uvd_px)
        spread = rig.triangulation_jacobian(p_R) @ (1.0 / known.inv_sigma)[:, :, None]
        own = np.sum(spread[..., 0] ** 2, axis=1)
        gate_m = 4.0 * np.sqrt(own + np.trace(known.covariance, axis1=1, axis2=2))
        X, _ = ransac_orientation(p_R, known.p_G, gate_m, np.random.default_rng([seed, m]))
        X, agree = refine(rig, known, X, agreement(rig, known, X))
        if agree.sum() >= max(LEAST_COMMON, LEAST_ENOUGH * m):
            return Located(X, agree, "map")
    if guess is None:
        return Located(np.eye(4), np.zeros(m, bool), "nothing")
    return Located(guess, agreement(rig, known, guess), "nothing")


def agreement(rig: RectifiedRig, known: Known, X_RG: Array) -> Bools:
    """(m,) which observations lie within the gate."""
    r, J = whitened(rig, known, X_RG)
    spread = np.eye(3) + J @ known.covariance @ np.swapaxes(J, 1, 2)
    squared = np.einsum("mi,mi->m", r, np.linalg.solve(spread, r[..., None])[..., 0])
    return np.asarray(squared < ARRIVAL_GATE**2)


def whitened(rig: RectifiedRig, known: Known, X_RG: Array) -> tuple[Array, Array]:
    """Residuals (m, 3) over their sigma, and their derivative (m, 3, 3) in the landmark's position in G."""
    R, p = X_RG[:3, :3], X_RG[:3, 3]
    p_R = known.p_G @ R.T + p
    # behind the camera nothing agrees
    p_R[:, 2] = np.maximum(p_R[:, 2], 1e-3)
    f, b = rig.focal_px, rig.baseline_m
    x, y, z = p_R.T
    D = np.zeros((len(p_R), 3, 3))
    D[:, 0, 0] = D[:, 1, 1] = -f / z
    D[:, 0, 2], D[:, 1, 2], D[:, 2, 2] = f * x / z**2, f * y / z**2, f * b / z**2
    r = (known.uvd_px - rig.project(p_R)) * known.inv_sigma
    return r, known.inv_sigma[:, :, None] * (D @ R)


def refine(rig: RectifiedRig, known: Known, X_RG: Array, agree: Bools) -> tuple[Array, Bools]:
    """Least squares of the pose on the observations that agree, which are chosen again each time."""
    X = X_RG.copy()
    for _ in range(REFINEMENTS):
        if agree.sum() < LEAST_COMMON:
            return X, agree
        part = Known(*(a[agree] for a in (known.uvd_px, known.inv_sigma, known.p_G, known.covariance)))
        r, J = whitened(rig, part, X)
        # X_RG Exp(shift, theta): the landmark moves by shift - p_G x theta
        J6 = np.concatenate([J, -J @ hat(part.p_G)], axis=2)
        W = np.linalg.inv(np.eye(3) + J @ part.covariance @ np.swapaxes(J, 1, 2))
        H = np.einsum("mia,mij,mjb->ab", J6, W, J6)
        g = np.einsum("mia,mij,mj->a", J6, W, r)
        step = -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(6), g)
        X[:3, 3] = X[:3, 3] + X[:3, :3] @ step[:3]
        X[:3, :3] = X[:3, :3] @ exp_so3(step[3:])
        agree = agreement(rig, known, X)
    return X, agree
