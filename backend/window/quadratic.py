"""Gaussian information about a vector, and what is left of it when a part of the vector is eliminated."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from polhode.lie import Array
from polhode.records import Ints


@dataclass(frozen=True)
class Quadratic:
    """The cost 1/2 (x - x0)^T H (x - x0) + g^T (x - x0)."""

    H: Array
    """(n, n) symmetric"""
    g: Array
    """(n,) gradient at x0"""
    x0: Array
    """(n,)"""

    def gradient(self, x: Array) -> Array:
        """Gradient (n,) at x."""
        return np.asarray(self.g + self.H @ (x - self.x0))

    def value(self, x: Array) -> float:
        """Cost at x, without the constant."""
        d = x - self.x0
        return float(d @ (self.g + 0.5 * (self.H @ d)))


@dataclass(frozen=True)
class Elimination:
    """What is left about the ``kept`` entries when the best ``gone`` ones follow them.

    For a Gaussian that is its marginal.
    """

    H: Array
    """(k, k)"""
    g: Array
    """(k,)"""
    solved: Array
    """(n - k, k + 1) of H[gone, gone]^-1 [H[gone, kept], g[gone]]"""

    def follow(self, step: Array) -> Array:
        """Step of the eliminated entries (n - k,) when the kept ones take theirs (k,)."""
        return np.asarray(-self.solved[:, :-1] @ step - self.solved[:, -1])


def eliminate(H: Array, g: Array, gone: Ints, kept: Ints) -> Elimination:
    """Eliminate entries of a quadratic about 0. H[gone, gone] must be positive definite."""
    if len(gone) == 0:
        return Elimination(H[np.ix_(kept, kept)], g[kept], np.zeros((0, len(kept) + 1)))
    factor = cho_factor(H[np.ix_(gone, gone)], lower=True, check_finite=False)
    across = H[np.ix_(gone, kept)]
    solved = cho_solve(factor, np.column_stack([across, g[gone]]), check_finite=False)
    left = H[np.ix_(kept, kept)] - across.T @ solved[:, :-1]
    return Elimination(0.5 * (left + left.T), g[kept] - across.T @ solved[:, -1], solved)
