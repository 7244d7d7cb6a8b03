"""Blocks of dense symmetric matrices: taken out, put in, added, without the copies of index arrays."""

import numpy as np

from polhode.compiled import compiled
from polhode.lie import Array
from polhode.records import Ints


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


@compiled
def mirror_lower(S: Array) -> None:
    """Copy the lower triangle to the upper one, in place."""
    for a in range(len(S)):
        for b in range(a):
            S[b, a] = S[a, b]


def others(entries: Ints, size: int) -> Ints:
    """The numbers below ``size`` that are not among the entries."""
    rest = np.ones(size, bool)
    rest[entries] = False
    return np.flatnonzero(rest)
