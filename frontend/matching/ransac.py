"""Motion between two stereo frames: RANSAC on absolute orientation (thesis 2.7; Horn 1987, Umeyama 1991)."""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, transform_points
from polhode.geometry.rigid_fit import fit_rigid
from polhode.geometry.small_systems import solve_symmetric
from polhode.runtime.compiled import compiled_reordered

HYPOTHESES = 300
"""Number of minimal samples."""
GATE_PX = 2.0
"""Largest reprojection error of an inlier."""
NOISE_PX = np.array([0.7, 0.7, 0.25])
"""Noise of u, v and disparity of features [px]; only the ratios matter."""
MIN_SUPPORT = 4
"""Inliers of the best minimal sample, of which three are the sample: with fewer the fit is not refined."""
_TINY = 1e-12
MIN_DEPTH_M = 1e-6
"""Points nearer to the camera's plane, or behind it, are not seen [m]."""
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

    def inliers(X: Array) -> Bools:
        return np.asarray(reprojection_error_px(transform_points(X, p_Rj), uvd_i, rig) < GATE_PX)

    triples = _sample_triples(len(uvd_i), rng)
    camera = rig.focal_px, rig.cx_px, rig.cy_px, rig.baseline_m, rig.disparity_offset_px
    p_Ri, p_Rj = np.ascontiguousarray(p_Ri), np.ascontiguousarray(p_Rj)
    X = np.eye(4)
    support = _best_motion(
        triples, p_Ri, p_Rj, np.ascontiguousarray(p_Rj.T), np.ascontiguousarray(uvd_i.T), *camera, X
    )
    inlier = inliers(X)
    if support < MIN_SUPPORT:
        return RigidFit(X, inlier)
    for _ in range(4):
        if inlier.sum() < 3:
            break
        # The error of stereo is largest along the ray, and proportional to the square of the range.
        X = fit_rigid(p_Ri[inlier], p_Rj[inlier], 1.0 / np.maximum(p_Ri[inlier, 2], 1e-6) ** 4)
        update = inliers(X)
        if np.array_equal(update, inlier):
            break
        inlier = update
    for _ in range(2):
        if inlier.sum() < 4:
            break
        X = fit_noisy(X, p_Ri[inlier], p_Rj[inlier], rig)
        inlier = inliers(X)
    return RigidFit(X, inlier)


def fit_noisy(X_AB: Array, p_A: Array, p_B: Array, rig: RectifiedRig, rounds: int = 4) -> Array:
    """X_AB (4, 4) by robust least squares from an initial value, for points p_A, p_B (n, 3), n >= 4.

    Each difference is weighted by the covariances of both points: stereo is more accurate across the ray than
    along it, and the rays of the two frames differ in the body.
    """
    X = X_AB.copy()
    _fit_noisy(X, np.ascontiguousarray(p_A), np.ascontiguousarray(p_B), rig.focal_px, rig.baseline_m, rounds)
    return X


@compiled_reordered
def _fit_noisy(X: Array, p_A: Array, p_B: Array, focal_px: float, baseline_m: float, rounds: int) -> None:
    """Improve the motion X (4, 4) in place."""
    normal, rhs = np.empty((6, 6)), np.empty(6)
    L, step, turn = np.zeros((6, 6)), np.empty(6), np.empty((3, 3))
    C_A, C_B, W = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    moved, miss, W_miss = np.empty(3), np.empty(3), np.empty(3)
    J = np.zeros((3, 6))
    for a in range(3):
        J[a, 3 + a] = 1.0
    for _ in range(rounds):
        for i in range(6):
            rhs[i] = 0.0
            for j in range(6):
                normal[i, j] = 0.0
        for k in range(len(p_A)):
            _covariance(p_A[k], focal_px, baseline_m, C_A)
            _covariance(p_B[k], focal_px, baseline_m, C_B)
            for a in range(3):
                moved[a] = X[a, 0] * p_B[k, 0] + X[a, 1] * p_B[k, 1] + X[a, 2] * p_B[k, 2] + X[a, 3]
                miss[a] = p_A[k, a] - moved[a]
                for b in range(3):
                    value = C_A[a, b]
                    for c in range(3):
                        for d in range(3):
                            value += X[a, c] * C_B[c, d] * X[b, d]
                    W[a, b] = value
            _invert(W)
            square = 0.0
            for a in range(3):
                W_miss[a] = W[a, 0] * miss[0] + W[a, 1] * miss[1] + W[a, 2] * miss[2]
                square += miss[a] * W_miss[a]
            # Geman and McClure
            weight = 1.0 / (1.0 + square / ROBUST) ** 2
            x, y, z = moved[0], moved[1], moved[2]
            J[0, 1], J[0, 2], J[1, 0], J[1, 2], J[2, 0], J[2, 1] = z, -y, -z, x, y, -x
            for i in range(6):
                for a in range(3):
                    rhs[i] += weight * J[a, i] * W_miss[a]
                    along = weight * (J[0, i] * W[0, a] + J[1, i] * W[1, a] + J[2, i] * W[2, a])
                    for j in range(i + 1):
                        normal[i, j] += along * J[a, j]
        trace = 0.0
        for i in range(6):
            trace += normal[i, i]
        for i in range(6):
            normal[i, i] += 1e-9 * trace
            for j in range(i):
                normal[j, i] = normal[i, j]
        solve_symmetric(normal, rhs, L, step)
        _exp(step, turn)
        for b in range(4):
            x, y, z = X[0, b], X[1, b], X[2, b]
            for a in range(3):
                X[a, b] = turn[a, 0] * x + turn[a, 1] * y + turn[a, 2] * z
        for a in range(3):
            X[a, 3] += step[3 + a]


@compiled_reordered
def _covariance(p_R: Array, focal_px: float, baseline_m: float, C: Array) -> None:
    """Covariance (3, 3) of a point by ``NOISE_PX``."""
    x, y, z = p_R[0], p_R[1], p_R[2]
    across = (NOISE_PX[0] * z / focal_px) ** 2
    along = (NOISE_PX[2] * z * z / (focal_px * baseline_m)) ** 2
    r = x / z, y / z, 1.0
    for a in range(3):
        for b in range(3):
            C[a, b] = along * r[a] * r[b]
    C[0, 0] += across
    C[1, 1] += across


@compiled_reordered
def _invert(W: Array) -> None:
    """The inverse of a symmetric matrix (3, 3), in place."""
    a, b, c, d, e, f = W[0, 0], W[0, 1], W[0, 2], W[1, 1], W[1, 2], W[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * A + b * B + c * C)
    W[0, 0], W[1, 1], W[2, 2] = A * scale, (a * f - c * c) * scale, (a * d - b * b) * scale
    W[0, 1], W[0, 2], W[1, 2] = B * scale, C * scale, (b * c - a * e) * scale
    W[1, 0], W[2, 0], W[2, 1] = W[0, 1], W[0, 2], W[1, 2]


@compiled_reordered
def _exp(w: Array, R: Array) -> None:
    """Rotation (3, 3) by the vector of the first three entries (Rodrigues)."""
    x, y, z = w[0], w[1], w[2]
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    if angle > 1e-4:
        s, c = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    else:
        s, c = 1.0 - square / 6.0, 0.5 - square / 24.0
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    R[1, 0], R[1, 1], R[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    R[2, 0], R[2, 1], R[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)


def reprojection_error_px(p_R: Array, uvd_px: Array, rig: RectifiedRig) -> Array:
    """The larger of image distance and disparity error (...) [px]; infinite behind the camera."""
    in_front = p_R[..., 2] > MIN_DEPTH_M
    safe = np.where(in_front[..., None], p_R, [0.0, 0.0, 1.0])
    error = rig.project(safe) - uvd_px
    worst = np.maximum(np.hypot(error[..., 0], error[..., 1]), np.abs(error[..., 2]))
    return np.asarray(np.where(in_front, worst, np.inf))


@compiled_reordered
def _best_motion(
    triples: Ints,
    p_Ri: Array,
    p_Rj: Array,
    p: Array,
    uvd_i: Array,
    focal_px: float,
    cx_px: float,
    cy_px: float,
    baseline_m: float,
    offset_px: float,
    X: Array,
) -> int:
    """The motion by three of the matches (n, 3) with most inliers, into X (4, 4); returns their number.

    p (3, n): p_Rj; uvd_i (3, n)
    """
    u, v, d = uvd_i[0], uvd_i[1], uvd_i[2]
    x, y, z = p[0], p[1], p[2]
    A, B, R = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    most = -1
    for h in range(len(triples)):
        k0, k1, k2 = triples[h, 0], triples[h, 1], triples[h, 2]
        _triad(p_Ri[k0], p_Ri[k1], p_Ri[k2], A)
        _triad(p_Rj[k0], p_Rj[k1], p_Rj[k2], B)
        for a in range(3):
            for b in range(3):
                R[a, b] = A[a, 0] * B[b, 0] + A[a, 1] * B[b, 1] + A[a, 2] * B[b, 2]
        mid_x = (p_Rj[k0, 0] + p_Rj[k1, 0] + p_Rj[k2, 0]) / 3.0
        mid_y = (p_Rj[k0, 1] + p_Rj[k1, 1] + p_Rj[k2, 1]) / 3.0
        mid_z = (p_Rj[k0, 2] + p_Rj[k1, 2] + p_Rj[k2, 2]) / 3.0
        xx, xy, xz, yx, yy, yz = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
        zx, zy, zz = R[2, 0], R[2, 1], R[2, 2]
        tx = (p_Ri[k0, 0] + p_Ri[k1, 0] + p_Ri[k2, 0]) / 3.0 - (xx * mid_x + xy * mid_y + xz * mid_z)
        ty = (p_Ri[k0, 1] + p_Ri[k1, 1] + p_Ri[k2, 1]) / 3.0 - (yx * mid_x + yy * mid_y + yz * mid_z)
        tz = (p_Ri[k0, 2] + p_Ri[k1, 2] + p_Ri[k2, 2]) / 3.0 - (zx * mid_x + zy * mid_y + zz * mid_z)
        inliers = 0
        for k in range(len(x)):
            depth = zx * x[k] + zy * y[k] + zz * z[k] + tz
            scale = focal_px / max(depth, MIN_DEPTH_M)
            du = (xx * x[k] + xy * y[k] + xz * z[k] + tx) * scale + cx_px - u[k]
            dv = (yx * x[k] + yy * y[k] + yz * z[k] + ty) * scale + cy_px - v[k]
            dd = baseline_m * scale + offset_px - d[k]
            near = (du * du + dv * dv < GATE_PX * GATE_PX) & (abs(dd) < GATE_PX)
            inliers += int(near & (depth > MIN_DEPTH_M))
        if inliers > most:
            most = inliers
            for a in range(3):
                for b in range(3):
                    X[a, b] = R[a, b]
            X[0, 3], X[1, 3], X[2, 3] = tx, ty, tz
    return most


@compiled_reordered
def _triad(a: Array, b: Array, c: Array, axes: Array) -> None:
    """Axes (3, 3) of a triangle, by edge and normal (TRIAD; Black 1964); columns."""
    ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = max(np.sqrt(ex * ex + ey * ey + ez * ez), _TINY)
    ex, ey, ez = ex / length, ey / length, ez / length
    fx, fy, fz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    length = max(np.sqrt(nx * nx + ny * ny + nz * nz), _TINY)
    nx, ny, nz = nx / length, ny / length, nz / length
    axes[0, 0], axes[1, 0], axes[2, 0] = ex, ey, ez
    axes[0, 1], axes[1, 1], axes[2, 1] = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
    axes[0, 2], axes[1, 2], axes[2, 2] = nx, ny, nz


def _sample_triples(n: int, rng: np.random.Generator) -> np.ndarray[tuple[int, int], np.dtype[np.intp]]:
    """Minimal samples (HYPOTHESES, 3) without repetition within a triple."""
    first = rng.integers(0, n, HYPOTHESES)
    second = (first + rng.integers(1, max(n, 2), HYPOTHESES)) % n
    low, high = np.minimum(first, second), np.maximum(first, second)
    third = rng.integers(0, max(n - 2, 1), HYPOTHESES)
    third = third + (third >= low)
    third = third + (third >= high)
    return np.stack([first, second, third % n], axis=1).astype(np.intp)
