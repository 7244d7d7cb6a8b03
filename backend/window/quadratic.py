"""Gaussian information about a vector, its marginals, and blocks of dense symmetric matrices."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from polhode.compiled import compiled
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
    """Information on the ``kept`` entries, the ``gone`` ones minimized over: the marginal of a Gaussian."""

    H: Array
    """(k, k)"""
    g: Array
    """(k,)"""
    factor: Array
    """(n - k, n - k) lower L with L L^T = H[gone, gone]"""
    across: Array
    """(n - k, k + 1) of L^-1 [H[gone, kept], g[gone]]"""

    def follow(self, step: Array) -> Array:
        """Step of the eliminated entries (n - k,) that follows from that of the kept ones (k,)."""
        if len(self.factor) == 0:
            return np.zeros(0)
        right = self.across[:, :-1] @ step + self.across[:, -1]
        return np.asarray(-solve_triangular(self.factor, right, lower=True, trans=1, check_finite=False))


def eliminate(H: Array, g: Array, gone: Ints, kept: Ints) -> Elimination:
    """Eliminate entries of a quadratic about 0. H[gone, gone] must be positive definite."""
    left, force = block_of(H, kept, kept), g[kept]
    if len(gone) == 0:
        return Elimination(left, force, np.zeros((0, 0)), np.zeros((0, len(kept) + 1)))
    factor = cholesky(block_of(H, gone, gone), lower=True, check_finite=False)
    both = np.empty((len(gone), len(kept) + 1))
    both[:, :-1], both[:, -1] = block_of(H, gone, kept), g[gone]
    across = solve_triangular(factor, both, lower=True, check_finite=False)
    from_kept, from_force = np.ascontiguousarray(across[:, :-1]), across[:, -1]
    left -= from_kept.T @ from_kept
    return Elimination(left, force - from_kept.T @ from_force, factor, across)


@compiled
def add_block(H: Array, entries: Ints, block: Array) -> None:
    """H[entries, entries] += block (n, n), in place."""
    n = len(entries)
    for a in range(n):
        row = entries[a]
        for b in range(n):
            H[row, entries[b]] += block[a, b]


@compiled
def block_of(H: Array, rows: Ints, columns: Ints) -> Array:
    """H[rows, columns] (n, m)."""
    out = np.empty((len(rows), len(columns)))
    for a in range(len(rows)):
        row = rows[a]
        for b in range(len(columns)):
            out[a, b] = H[row, columns[b]]
    return out


def others(entries: Ints, size: int) -> Ints:
    """The indices below ``size`` that are not among the entries."""
    rest = np.ones(size, bool)
    rest[entries] = False
    return np.flatnonzero(rest)
