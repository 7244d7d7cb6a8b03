"""The one module that converts quaternions. Hamilton convention, scalar first (``_wxyz``)."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from polhode.lie import Array


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
