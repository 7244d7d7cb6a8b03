"""Elimination of the unknowns that couple neighbouring frames only: velocities, rates, the camera's errors.

Landmarks couple the poses of all frames that see them. The other unknowns of a frame couple to the frames
before and after, and to the constants: a chain, whose Cholesky factor has two blocks per frame. Eliminating
the chain halves the dense system, whose factorization then costs an eighth.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from polhode.backend.problem.iterate import N_POSE
from polhode.geometry.lie import Array
from polhode.runtime.compiled import compiled

PANEL = 96
"""Columns that are updated at once."""


@dataclass(frozen=True)
class ChainFactor:
    """Factor of the chain's block, and the chain's coupling with poses and constants behind it."""

    diagonal: Array
    """(F, d, d) lower Cholesky blocks"""
    below: Array
    """(F, d, d) blocks below them, the last one unused"""
    coupling: Array
    """(F d, 6 F + c): the inverse factor times the coupling with poses, then constants"""
    gradient: Array
    """(F d,) the inverse factor times the gradient"""
    dense: Array
    """(6 F + c, 6 F + c) lower: poses and constants after elimination of the chain"""
    dense_gradient: Array
    """(6 F + c,)"""


def eliminate_chain(H: Array, g: Array, n_frames: int, n_state: int, damping: float = 0.0) -> ChainFactor:
    """Split H (n, n), g (n,), constants last, into chain and rest; the diagonal grows by the damping.

    Raises LinAlgError when the chain's block is not positive definite.
    """
    d, n_poses = n_state - N_POSE, N_POSE * n_frames
    size = n_poses + len(g) - n_state * n_frames
    diagonal, below = np.zeros((n_frames, d, d)), np.zeros((n_frames, d, d))
    X, y = np.zeros((n_frames * d, size)), np.zeros(n_frames * d)
    dense, dense_gradient = np.empty((size, size)), np.empty(size)
    _gather(H, g, n_frames, n_state, damping, dense, dense_gradient)
    if not _factor(H, g, n_frames, n_state, 1.0 + damping, diagonal, below, X, y):
        raise LinAlgError("the chain is not positive definite")
    # where this overflows the Cholesky factorization fails later
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, n_poses, PANEL):
            end = min(start + PANEL, n_poses)
            # rows of X above this one are zero in these columns
            first = max(start // N_POSE - 1, 0) * d
            dense[start:end, :end] -= X[first:, start:end].T @ X[first:, :end]
        dense[n_poses:] -= X[:, n_poses:].T @ X
        dense_gradient -= X.T @ y
    return ChainFactor(diagonal, below, X, y, dense, dense_gradient)


def solve_with_chain(chain: ChainFactor, n_state: int) -> tuple[Array, float]:
    """Solution (n,) of ``H step = -g``, after other unknowns were eliminated from the dense part, if any.

    Also returns half the logarithm of the determinant of H after that. Raises LinAlgError when the dense part
    is not positive definite. Overwrites ``chain.dense``.
    """
    factor = cho_factor(chain.dense, lower=True, overwrite_a=True, check_finite=False)
    rest = -cho_solve(factor, chain.dense_gradient, check_finite=False)
    along = chain.gradient + chain.coupling @ rest
    n_frames = len(chain.diagonal)
    states = np.empty((n_frames, n_state))
    states[:, :N_POSE] = rest[: N_POSE * n_frames].reshape(-1, N_POSE)
    states[:, N_POSE:] = _back_substitute(chain.diagonal, chain.below, along)
    of_chain = np.log(np.diagonal(chain.diagonal, axis1=1, axis2=2)).sum()
    half_log_det = float(of_chain + np.log(np.diagonal(factor[0])).sum())
    return np.concatenate([states.ravel(), rest[N_POSE * n_frames :]]), half_log_det


def half_log_det(H: Array, n_frames: int, n_state: int) -> float:
    """Half the logarithm of the determinant of H (n, n), lower triangle, constants last.

    Raises LinAlgError when it is not positive definite.
    """
    return solve_with_chain(eliminate_chain(H, np.zeros(len(H)), n_frames, n_state), n_state)[1]


@compiled
def _gather(
    H: Array, g: Array, n_frames: int, s: int, damping: float, dense: Array, dense_gradient: Array
) -> None:
    """Poses and constants of H, lower triangle."""
    size, n_poses, n_states = len(dense), N_POSE * n_frames, s * n_frames
    at = np.empty(size, dtype=np.int64)
    for a in range(size):
        at[a] = s * (a // N_POSE) + a % N_POSE if a < n_poses else n_states + a - n_poses
    for a in range(size):
        dense_gradient[a] = g[at[a]]
        for b in range(a + 1):
            dense[a, b] = H[at[a], at[b]]
        dense[a, a] *= 1.0 + damping


@compiled
def _factor(
    H: Array, g: Array, n_frames: int, s: int, grow: float, diagonal: Array, below: Array, X: Array, y: Array
) -> bool:
    """Fill the fields of ``ChainFactor``; False if a pivot is not positive."""
    d, n_poses, n_states = s - N_POSE, N_POSE * n_frames, s * n_frames
    constants = len(g) - n_states
    for k in range(n_frames):
        at, row = s * k + N_POSE, d * k
        L = diagonal[k]
        for i in range(d):
            for j in range(i + 1):
                L[i, j] = H[at + i, at + j] * (grow if i == j else 1.0)
            for p in range(max(k - 1, 0), min(k + 2, n_frames)):
                for c in range(N_POSE):
                    b = s * p + c
                    X[row + i, N_POSE * p + c] = H[at + i, b] if b < at else H[b, at + i]
            for c in range(constants):
                X[row + i, n_poses + c] = H[n_states + c, at + i]
            y[row + i] = g[at + i]
        if k > 0:
            left, filled = below[k - 1], N_POSE * (k + 1)
            for i in range(d):
                for j in range(d):
                    factor = left[i, j]
                    for c in range(i + 1):
                        L[i, c] -= factor * left[c, j]
                    for c in range(filled):
                        X[row + i, c] -= factor * X[row - d + j, c]
                    for c in range(n_poses, n_poses + constants):
                        X[row + i, c] -= factor * X[row - d + j, c]
                    y[row + i] -= factor * y[row - d + j]
        if not _cholesky(L):
            return False
        filled = N_POSE * min(k + 2, n_frames)
        for i in range(d):
            for j in range(i):
                for c in range(filled):
                    X[row + i, c] -= L[i, j] * X[row + j, c]
                for c in range(n_poses, n_poses + constants):
                    X[row + i, c] -= L[i, j] * X[row + j, c]
                y[row + i] -= L[i, j] * y[row + j]
            scale = 1.0 / L[i, i]
            for c in range(filled):
                X[row + i, c] *= scale
            for c in range(n_poses, n_poses + constants):
                X[row + i, c] *= scale
            y[row + i] *= scale
        if k + 1 < n_frames:
            for i in range(d):
                for j in range(d):
                    value = H[at + s + i, at + j]
                    for c in range(j):
                        value -= below[k, i, c] * L[j, c]
                    below[k, i, j] = value / L[j, j]
    return True


@compiled
def _cholesky(A: Array) -> bool:
    """Lower factor of A (d, d) in place, from its lower triangle; False if a pivot is not positive."""
    for j in range(len(A)):
        for c in range(j):
            A[j, j] -= A[j, c] ** 2
        if not A[j, j] > 0.0:
            return False
        A[j, j] = np.sqrt(A[j, j])
        for i in range(j + 1, len(A)):
            for c in range(j):
                A[i, j] -= A[i, c] * A[j, c]
            A[i, j] /= A[j, j]
    return True


@compiled
def _back_substitute(diagonal: Array, below: Array, along: Array) -> Array:
    """Minus the transposed inverse factor times ``along`` (F d,): (F, d)."""
    n_frames, d = len(diagonal), diagonal.shape[1]
    out = np.empty((n_frames, d))
    for k in range(n_frames - 1, -1, -1):
        for i in range(d - 1, -1, -1):
            value = -along[d * k + i]
            if k + 1 < n_frames:
                for j in range(d):
                    value -= below[k, j, i] * out[k + 1, j]
            for j in range(i + 1, d):
                value -= diagonal[k, j, i] * out[k, j]
            out[k, i] = value / diagonal[k, i, i]
    return out
