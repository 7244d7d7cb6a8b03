"""Gathering unknowns for kernels, scattering their blocks: the constant parts of a CasADi program."""

from typing import Any

import casadi as ca
import numpy as np

from polhode.records import Ints


def gather(vector: Any, slots: Ints) -> Any:
    """Columns of a matrix (width, n) from the entries ``slots`` (n, width) of a vector."""
    return ca.reshape(vector[slots.ravel().tolist()], slots.shape[1], slots.shape[0])


def scatter(target: Ints, size: int) -> Any:
    """Constant matrix (size, n) that adds entry e of a vector to ``target[e]``."""
    n = len(target)
    return ca.DM(ca.Sparsity(size, n, list(range(n + 1)), target.tolist()), np.ones(n))


def upper_keys(slots: Ints, n_x: int) -> Ints:
    """Cells ``column * n_x + row`` of the upper blocks of each row of slots (n, width), by columns."""
    width = slots.shape[1]
    cols, rows = np.tril_indices(width)
    return np.asarray(slots[:, cols] * n_x + slots[:, rows]).ravel()


def upper_sparsity(cells: Ints, n_x: int) -> Any:
    """Of a symmetric matrix (n_x, n_x) with these cells, sorted."""
    columns, rows = np.divmod(cells, n_x)
    offsets = np.searchsorted(columns, np.arange(n_x + 1))
    return ca.Sparsity(n_x, n_x, offsets.tolist(), rows.tolist())
