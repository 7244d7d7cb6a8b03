"""Normal equations of the stereo measurements and elimination of the landmarks (Schur complement), compiled.

The loops state residual and Jacobian of a stereo measurement themselves, fused with the sums of the blocks;
``polhode.geometry.camera`` has the same for arrays of points.
"""

import numpy as np

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled, compiled_fused

BLOCK = 64


@compiled
def stereo_residuals(
    frame: Ints, landmark: Ints, uvd: Array, inv_sigma: Array, rig: Array, A: Array, R_RN: Array, t_R: Array,
    p_NG: Array, p_G: Array,
) -> Array:  # fmt: skip
    """Whitened residuals (M, 3). A = R_RN R_NG at the current attitudes (F, 3, 3)."""
    out = np.empty((len(frame), 3))
    for m in range(len(frame)):
        k, mark = frame[m], landmark[m]
        x = y = z = 0.0
        for c in range(3):
            x += A[k, 0, c] * p_G[mark, c] + R_RN[k, 0, c] * p_NG[k, c]
            y += A[k, 1, c] * p_G[mark, c] + R_RN[k, 1, c] * p_NG[k, c]
            z += A[k, 2, c] * p_G[mark, c] + R_RN[k, 2, c] * p_NG[k, c]
        x, y, z = x + t_R[k, 0], y + t_R[k, 1], z + t_R[k, 2]
        out[m, 0] = (uvd[m, 0] - rig[0] * x / z - rig[1]) * inv_sigma[m, 0]
        out[m, 1] = (uvd[m, 1] - rig[0] * y / z - rig[2]) * inv_sigma[m, 1]
        out[m, 2] = (uvd[m, 2] - rig[0] * rig[3] / z - rig[4]) * inv_sigma[m, 2]
    return out


@compiled_fused
def stereo_normal_equations(
    frame: Ints, landmark: Ints, inv_sigma: Array, rig: Array, A: Array, R_RN: Array, t_R: Array,
    p_NG: Array, p_G: Array, Jr: Array, residuals: Array, weight: Array, curvature: Array,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """Blocks of the Gauss-Newton system of the weighted residuals.

    Jr (F, 3, 3) right Jacobian at the current theta: the attitude variable is theta itself; curvature (M,) of
    the robust kernel (``robust_kernel.kernel_curvature``). Returns H (F, 6, 6), g (F, 6) of the poses; C (L,
    3, 3), h (L, 3) of the landmarks; E (M, 6, 3) coupling.
    """
    n_frames, n_landmarks, n = len(p_NG), len(p_G), len(frame)
    H, g = np.zeros((n_frames, 6, 6)), np.zeros((n_frames, 6))
    C, h, E = np.zeros((n_landmarks, 3, 3)), np.zeros((n_landmarks, 3)), np.empty((n, 6, 3))
    J, f, fb = np.empty((3, 9)), rig[0], rig[0] * rig[3]
    for m in range(n):
        # unsigned indices: see ``subtract_landmarks``
        k, mark = np.uint64(frame[m]), np.uint64(landmark[m])
        x, y, z = t_R[k, 0], t_R[k, 1], t_R[k, 2]
        for c in range(np.uint64(3)):
            x += A[k, 0, c] * p_G[mark, c] + R_RN[k, 0, c] * p_NG[k, c]
            y += A[k, 1, c] * p_G[mark, c] + R_RN[k, 1, c] * p_NG[k, c]
            z += A[k, 2, c] * p_G[mark, c] + R_RN[k, 2, c] * p_NG[k, c]
        # derivatives of the prediction in p_R, then of the residual
        fz = f / z
        xz, yz, bz = fz * x / z, fz * y / z, fb / z**2
        a, b, e = p_G[mark, 0], p_G[mark, 1], p_G[mark, 2]
        w = weight[m]
        s0, s1, s2 = inv_sigma[m, 0], inv_sigma[m, 1], inv_sigma[m, 2]
        for c in range(np.uint64(3)):
            J[0, c] = s0 * (xz * R_RN[k, 2, c] - fz * R_RN[k, 0, c])
            J[1, c] = s1 * (yz * R_RN[k, 2, c] - fz * R_RN[k, 1, c])
            J[2, c] = s2 * bz * R_RN[k, 2, c]
            J[0, 6 + c] = s0 * (xz * A[k, 2, c] - fz * A[k, 0, c])
            J[1, 6 + c] = s1 * (yz * A[k, 2, c] - fz * A[k, 1, c])
            J[2, 6 + c] = s2 * bz * A[k, 2, c]
        for c in range(np.uint64(3)):
            # -hat(p_G) Jr
            t0 = e * Jr[k, 1, c] - b * Jr[k, 2, c]
            t1 = a * Jr[k, 2, c] - e * Jr[k, 0, c]
            t2 = b * Jr[k, 0, c] - a * Jr[k, 1, c]
            for i in range(np.uint64(3)):
                J[i, 3 + c] = J[i, 6] * t0 + J[i, 7] * t1 + J[i, 8] * t2
        r0, r1, r2 = residuals[m, 0], residuals[m, 1], residuals[m, 2]
        for i in range(np.uint64(9)):
            along = J[0, i] * r0 + J[1, i] * r1 + J[2, i] * r2
            if i < 6:
                g[k, i] += w * along
            else:
                h[mark, i - 6] += w * along
            if curvature[m] != 0.0:
                J[0, i] -= curvature[m] * along * r0
                J[1, i] -= curvature[m] * along * r1
                J[2, i] -= curvature[m] * along * r2
        for i in range(np.uint64(6)):
            u0, u1, u2 = w * J[0, i], w * J[1, i], w * J[2, i]
            for j in range(np.uint64(6)):
                H[k, i, j] += u0 * J[0, j] + u1 * J[1, j] + u2 * J[2, j]
            for j in range(np.uint64(3)):
                E[m, i, j] = u0 * J[0, 6 + j] + u1 * J[1, 6 + j] + u2 * J[2, 6 + j]
        for i in range(np.uint64(3)):
            u0, u1, u2 = w * J[0, 6 + i], w * J[1, 6 + i], w * J[2, 6 + i]
            for j in range(np.uint64(3)):
                C[mark, i, j] += u0 * J[0, 6 + j] + u1 * J[1, 6 + j] + u2 * J[2, 6 + j]
    return H, g, C, h, E


@compiled_fused
def subtract_landmarks(
    S: Array, rhs: Array, frame: Ints, start: Ints, E: Array, C_inv: Array, h: Array, stride: int
) -> None:
    """S -= E C^-1 E^T (lower triangle) and rhs -= E C^-1 h, in place; pose k begins at ``stride * k``."""
    T, rows = np.empty((6, 3)), np.empty((len(E), 3, 6))
    for m in range(len(E)):
        for i in range(6):
            for j in range(3):
                rows[m, j, i] = E[m, i, j]
    for mark in range(len(start) - 1):
        for a in range(start[mark], start[mark + 1]):
            # an unsigned index needs no test for negative values: the innermost loop stays in registers
            ka = np.uint64(stride * frame[a])
            for i in range(6):
                for j in range(3):
                    T[i, j] = (
                        E[a, i, 0] * C_inv[mark, 0, j]
                        + E[a, i, 1] * C_inv[mark, 1, j]
                        + E[a, i, 2] * C_inv[mark, 2, j]
                    )
                rhs[ka + np.uint64(i)] -= T[i, 0] * h[mark, 0] + T[i, 1] * h[mark, 1] + T[i, 2] * h[mark, 2]
            for b in range(start[mark], a + 1):
                kb = np.uint64(stride * frame[b])
                for row in range(np.uint64(6)):
                    x, y, z = T[row, 0], T[row, 1], T[row, 2]
                    for column in range(np.uint64(6)):
                        S[ka + row, kb + column] -= (
                            x * rows[b, 0, column] + y * rows[b, 1, column] + z * rows[b, 2, column]
                        )


@compiled
def back_substitute(
    step: Array, frame: Ints, start: Ints, E: Array, C_inv: Array, h: Array, stride: int
) -> Array:
    """Landmark steps (L, 3) = C^-1 (h - E^T step), with step the solution of the reduced system."""
    out = np.empty((len(start) - 1, 3))
    rest = np.empty(3)
    for mark in range(len(start) - 1):
        for j in range(3):
            rest[j] = h[mark, j]
        for a in range(start[mark], start[mark + 1]):
            k = stride * frame[a]
            for j in range(3):
                for i in range(6):
                    rest[j] -= E[a, i, j] * step[k + i]
        for j in range(3):
            out[mark, j] = (
                C_inv[mark, j, 0] * rest[0] + C_inv[mark, j, 1] * rest[1] + C_inv[mark, j, 2] * rest[2]
            )
    return out


@compiled_fused
def correlated_scores(
    excess: Array, frame: Ints, start: Ints, variance: Array, drift: Array, to_pose: Array,
    to_landmark: Array, E: Array, C_inv: Array, stride: int,
) -> Array:  # fmt: skip
    """Covariance of the gradient in the poses in excess of the information, into ``excess`` (lower triangle).

    Landmarks eliminated. The whitened errors of u, v and disparity have variance (M, 3) and, besides, drift
    (3, F, F) between observations of one landmark in two frames; the information takes both as 1 and 0.
    to_pose (M, 3, 6), to_landmark (M, 3, 3): derivatives of the whitened residuals; pose k begins at ``stride
    * k``. Returns the landmarks' covariances (L, 3, 3), the poses given.
    """
    longest = 0
    for mark in range(len(start) - 1):
        longest = max(longest, start[mark + 1] - start[mark])
    own = np.zeros((len(start) - 1, 3, 3))
    y, z = np.empty((longest, 3)), np.empty((longest, 3))
    G, W, along = np.empty((3, 3)), np.empty((3, 6)), np.empty(6)
    for mark in range(len(start) - 1):
        first, n = start[mark], start[mark + 1] - start[mark]
        for c in range(3):
            for a in range(n):
                for i in range(3):
                    y[a, i] = 0.0
                    for j in range(3):
                        y[a, i] += C_inv[mark, i, j] * to_landmark[first + a, c, j]
            G[:] = 0.0
            for a in range(n):
                z[a] = 0.0
                for b in range(n):
                    v = drift[c, frame[first + a], frame[first + b]]
                    if a == b:
                        v += variance[first + a, c] - 1.0
                    for i in range(3):
                        z[a, i] += v * y[b, i]
                for i in range(3):
                    for j in range(3):
                        G[i, j] += y[a, i] * z[a, j]
            for i in range(3):
                for j in range(3):
                    own[mark, i, j] += G[i, j]
            for b in range(n):
                kb = stride * frame[first + b]
                for i in range(3):
                    for j in range(6):
                        W[i, j] = -z[b, i] * to_pose[first + b, c, j]
                        for p in range(3):
                            W[i, j] += G[i, p] * E[first + b, j, p]
                for a in range(b, n):
                    ka = stride * frame[first + a]
                    v = drift[c, frame[first + a], frame[first + b]]
                    if a == b:
                        v += variance[first + a, c] - 1.0
                    for j in range(6):
                        along[j] = v * to_pose[first + b, c, j]
                        for p in range(3):
                            along[j] -= E[first + b, j, p] * z[a, p]
                    for i in range(6):
                        for j in range(6):
                            total = to_pose[first + a, c, i] * along[j]
                            for p in range(3):
                                total += E[first + a, i, p] * W[p, j]
                            excess[ka + i, kb + j] += total
    return own + C_inv


@compiled_fused
def landmark_covariances(
    cov: Array, frame: Ints, start: Ints, E: Array, C_inv: Array, own: Array, stride: int
) -> Array:
    """Covariances (L, 3, 3) = own + C^-1 E^T cov E C^-1: own with the poses given, cov that of the poses."""
    out = own.copy()
    T, right = np.zeros((3, 3)), np.empty((6, 3))
    for mark in range(len(start) - 1):
        T[:] = 0.0
        for a in range(start[mark], start[mark + 1]):
            ka = np.uint64(stride * frame[a])
            right[:] = 0.0
            # frames before this one count twice, this one once
            for b in range(start[mark], a + 1):
                kb = np.uint64(stride * frame[b])
                times = 1.0 if a == b else 2.0
                for i in range(np.uint64(6)):
                    for j in range(np.uint64(6)):
                        s = times * cov[ka + i, kb + j]
                        for p in range(np.uint64(3)):
                            right[i, p] += s * E[b, j, p]
            for p in range(3):
                for q in range(3):
                    for n in range(6):
                        T[p, q] += E[a, n, p] * right[n, q]
        for p in range(3):
            for q in range(3):
                for n in range(3):
                    for m in range(3):
                        across = 0.5 * (T[n, m] + T[m, n])
                        out[mark, p, q] += C_inv[mark, p, n] * across * C_inv[mark, m, q]
    return out


@compiled
def mirror(A: Array) -> None:
    """Copy the lower triangle of A (n, n) to the upper one, in place."""
    for start in range(0, len(A), BLOCK):
        for other in range(0, start + 1, BLOCK):
            # a block at a time: both sides stay in the cache
            for i in range(start, min(start + BLOCK, len(A))):
                for j in range(other, min(other + BLOCK, i)):
                    A[j, i] = A[i, j]
