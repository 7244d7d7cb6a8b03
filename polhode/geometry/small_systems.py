"""Symmetric, positive definite systems of a few unknowns, inside compiled loops."""

import numpy as np

from polhode.geometry.lie import Array
from polhode.runtime.compiled import compiled_fused_ieee

_FLOOR = 1e-300


@compiled_fused_ieee
def solve_symmetric(A: Array, b: Array, L: Array, x: Array) -> None:
    """A x = b by Cholesky's factorisation A = L L^T, A (n, n); L (n, n) and x (n,) are written."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            value = A[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(value, _FLOOR)) if i == j else value / L[j, j]
    for i in range(n):
        value = b[i]
        for k in range(i):
            value -= L[i, k] * x[k]
        x[i] = value / L[i, i]
    for i in range(n - 1, -1, -1):
        value = x[i]
        for k in range(i + 1, n):
            value -= L[k, i] * x[k]
        x[i] = value / L[i, i]
