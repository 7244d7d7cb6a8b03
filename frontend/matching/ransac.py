"""Motion between two stereo frames: RANSAC on absolute orientation (thesis 2.7; Horn 1987, Umeyama 1991)."""

from dataclasses import dataclass

import numpy as np

from polhode.camera import RectifiedRig
from polhode.lie import Array, exp_so3, make_pose, transform_points
from polhode.records import Bools
from polhode.rigid_fit import fit_rigid

HYPOTHESES = 300
"""Number of minimal samples."""
GATE_PX = 2.0
"""Largest reprojection error of an inlier."""
NOISE_PX = np.array([0.7, 0.7, 0.25])
"""Noise of u, v and disparity of features [px]; only the ratios matter."""
ROBUST = 9.0
"""Squared error over variance at which the weight of a point is a quarter."""


@dataclass(frozen=True)
class RigidFit:
    """The best motion, and its inliers."""

    X_RiRj: Array
    """(4, 4) p_Ri = X_RiRj @ p_Rj"""
    inlier: Bools
    """(n,)"""


def ransac_rigid(
    uvd_i: Array,
    p_Ri: Array,
    p_Rj: Array,
    rig: RectifiedRig,
    rng: np.random.Generator,
) -> RigidFit:
    """The motion with most inliers among matches (n, 3) of frames i and j, n >= 3.

    The point of an inlier in frame j, transformed to frame i, projects within ``GATE_PX`` of the measured
    (u, v) and of the disparity: the gate is in pixels, so it is valid at every distance. ``uvd_i``:
    measurements of frame i.
    """
    triples = _sample_triples(len(uvd_i), rng)
    R, t = _triads(p_Ri[triples], p_Rj[triples])
    moved = np.einsum("hab,nb->hna", R, p_Rj) + t[:, None]
    agreement = _inliers(moved, uvd_i, rig)
    X = make_pose(R[(best := int(agreement.sum(axis=1).argmax()))], t[best])
    inlier = agreement[best]
    for _ in range(4):
        if inlier.sum() < 3:
            break
        # The error of stereo is largest along the ray, and proportional to the square of the range.
        X = fit_rigid(p_Ri[inlier], p_Rj[inlier], 1.0 / np.maximum(p_Ri[inlier, 2], 1e-6) ** 4)
        update = _inliers(transform_points(X, p_Rj), uvd_i, rig)
        if np.array_equal(update, inlier):
            break
        inlier = update
    for _ in range(2):
        if inlier.sum() < 4:
            break
        X = fit_noisy(X, p_Ri[inlier], p_Rj[inlier], rig)
        inlier = _inliers(transform_points(X, p_Rj), uvd_i, rig)
    return RigidFit(X, inlier)


def fit_noisy(X_AB: Array, p_A: Array, p_B: Array, rig: RectifiedRig, rounds: int = 4) -> Array:
    """X_AB (4, 4) by robust least squares from an initial value, for points p_A, p_B (n, 3), n >= 4.

    Each difference is weighted by the covariances of both points: stereo is more accurate across the ray than
    along it, and the rays of the two frames differ in the body.
    """
    C_A, C_B = _covariance(p_A, rig), _covariance(p_B, rig)
    for _ in range(rounds):
        R, moved = X_AB[:3, :3], transform_points(X_AB, p_B)
        W = np.linalg.inv(C_A + R @ C_B @ R.T)
        miss = p_A - moved
        W_miss = (W @ miss[..., None])[..., 0]
        # Geman and McClure
        W *= (1.0 / (1.0 + np.sum(miss * W_miss, axis=1) / ROBUST) ** 2)[:, None, None]
        J = np.zeros((len(p_A), 3, 6))
        J[:, :, 3:] = np.eye(3)
        x, y, z = moved.T
        J[:, 0, 1], J[:, 0, 2], J[:, 1, 0], J[:, 1, 2], J[:, 2, 0], J[:, 2, 1] = z, -y, -z, x, y, -x
        J_W = np.swapaxes(J, 1, 2) @ W
        normal = np.sum(J_W @ J, axis=0)
        rhs = np.einsum("nij,nj->i", J_W, miss)
        step = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(6), rhs)
        X_AB = make_pose(exp_so3(step[:3]), step[3:]) @ X_AB
    return X_AB


def _covariance(p_R: Array, rig: RectifiedRig) -> Array:
    J = rig.triangulation_jacobian(p_R)
    return np.asarray((J * NOISE_PX**2) @ np.swapaxes(J, 1, 2))


def reprojection_error_px(p_R: Array, uvd_px: Array, rig: RectifiedRig) -> Array:
    """The larger of image distance and disparity error (...) [px]; infinite behind the camera."""
    in_front = p_R[..., 2] > 1e-6
    safe = np.where(in_front[..., None], p_R, [0.0, 0.0, 1.0])
    error = rig.project(safe) - uvd_px
    worst = np.maximum(np.hypot(error[..., 0], error[..., 1]), np.abs(error[..., 2]))
    return np.asarray(np.where(in_front, worst, np.inf))


def _inliers(p_Ri: Array, uvd_i: Array, rig: RectifiedRig) -> Bools:
    return np.asarray(reprojection_error_px(p_Ri, uvd_i, rig) < GATE_PX)


def _sample_triples(n: int, rng: np.random.Generator) -> np.ndarray[tuple[int, int], np.dtype[np.intp]]:
    """Minimal samples (HYPOTHESES, 3) without repetition within a triple."""
    first = rng.integers(0, n, HYPOTHESES)
    second = (first + rng.integers(1, max(n, 2), HYPOTHESES)) % n
    low, high = np.minimum(first, second), np.maximum(first, second)
    third = rng.integers(0, max(n - 2, 1), HYPOTHESES)
    third = third + (third >= low)
    third = third + (third >= high)
    return np.stack([first, second, third % n], axis=1).astype(np.intp)


def _triads(p_A: Array, p_B: Array) -> tuple[Array, Array]:
    """Motion from triangles (h, 3, 3), by edge and normal (TRIAD; Black 1964): R_AB (h, 3, 3), t (h, 3)."""
    R = _triad(p_A) @ np.swapaxes(_triad(p_B), -1, -2)
    t = p_A.mean(axis=1) - np.einsum("hab,hb->ha", R, p_B.mean(axis=1))
    return R, t


def _triad(p: Array) -> Array:
    e1 = _unit(p[:, 1] - p[:, 0])
    e3 = _unit(np.cross(e1, p[:, 2] - p[:, 0]))
    return np.stack([e1, np.cross(e3, e1), e3], axis=-1)


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))
