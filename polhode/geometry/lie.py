"""SO(3), SE(3) and unit quaternions, batched over leading dimensions.

Attitude perturbations are on the right everywhere: ``R Exp(theta)`` (docs/notation.md).
Formulas: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018.
Quaternions follow the Hamilton convention, scalar first (``_wxyz``); no other module converts them.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def hat(v: ArrayLike) -> Array:
    """Cross-product matrix: ``hat(a) @ b == cross(a, b)``. v (..., 3) -> (..., 3, 3)."""
    v = np.asarray(v, dtype=np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp_so3(theta: ArrayLike) -> Array:
    """Rotation vector [rad] (..., 3) -> rotation matrix (..., 3, 3)."""
    theta = np.asarray(theta, dtype=np.float64)
    matrix = Rotation.from_rotvec(theta.reshape(-1, 3)).as_matrix()
    return np.asarray(matrix).reshape(*theta.shape[:-1], 3, 3)


def log_so3(R: ArrayLike) -> Array:
    """Rotation matrix (..., 3, 3) -> rotation vector [rad] (..., 3), angle in [0, pi]."""
    R = np.asarray(R, dtype=np.float64)
    rotvec = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(rotvec).reshape(*R.shape[:-2], 3)


def right_jacobian_so3(theta: ArrayLike) -> Array:
    """``Exp(theta + d) ~ Exp(theta) Exp(Jr(theta) d)``. theta (..., 3) -> (..., 3, 3)."""
    theta = np.asarray(theta, dtype=np.float64)
    angle = np.linalg.norm(theta, axis=-1)[..., None, None]
    small = angle < 1e-5
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    b = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    H = hat(theta)
    return np.asarray(np.eye(3) - a * H + b * (H @ H))


def make_pose(R: ArrayLike, p: ArrayLike) -> Array:
    """R (..., 3, 3), p (..., 3) [m] -> homogeneous matrix (..., 4, 4)."""
    R, p = np.asarray(R, dtype=np.float64), np.asarray(p, dtype=np.float64)
    X = np.zeros((*R.shape[:-2], 4, 4))
    X[..., :3, :3], X[..., :3, 3], X[..., 3, 3] = R, p, 1.0
    return X


def inverse_pose(X: ArrayLike) -> Array:
    """Inverse of a rigid transform (..., 4, 4)."""
    X = np.asarray(X, dtype=np.float64)
    R_T = np.swapaxes(X[..., :3, :3], -1, -2)
    return make_pose(R_T, -(R_T @ X[..., :3, 3:])[..., 0])


def transform_points(X_AB: ArrayLike, p_B: ArrayLike) -> Array:
    """p_A = X_AB @ p_B for points (..., 3)."""
    X_AB, p_B = np.asarray(X_AB, dtype=np.float64), np.asarray(p_B, dtype=np.float64)
    return np.asarray(p_B @ np.swapaxes(X_AB[..., :3, :3], -1, -2) + X_AB[..., None, :3, 3])


def matrix_from_wxyz(q_wxyz: ArrayLike) -> Array:
    """Unit quaternion (..., 4), scalar first -> rotation matrix (..., 3, 3)."""
    q = np.asarray(q_wxyz, dtype=np.float64)
    matrix = Rotation.from_quat(q.reshape(-1, 4)[:, [1, 2, 3, 0]]).as_matrix()
    return np.asarray(matrix).reshape(*q.shape[:-1], 3, 3)


def wxyz_from_matrix(R: ArrayLike) -> Array:
    """Rotation matrix (..., 3, 3) -> unit quaternion (..., 4), scalar first and >= 0."""
    R = np.asarray(R, dtype=np.float64)
    xyzw = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True)
    return np.asarray(xyzw[:, [3, 0, 1, 2]]).reshape(*R.shape[:-2], 4)


def continuous_wxyz(q_wxyz: ArrayLike) -> Array:
    """Choose the sign of each quaternion of a sequence (n, 4) so that neighbours do not jump."""
    q = np.array(q_wxyz, dtype=np.float64)
    signs = np.sign(np.sum(q[1:] * q[:-1], axis=1))
    q[1:] *= np.cumprod(np.where(signs == 0.0, 1.0, signs))[:, None]
    return q
