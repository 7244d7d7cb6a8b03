"""Directions spread evenly over the sphere, and the way back: which of them is nearest to a given one."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from polhode.compiled import compiled
from polhode.lie import Array

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
MAP_CELLS = 96
"""Cells along an edge of the map that finds the nearest direction."""


def even_directions(count: int) -> Array:
    """Unit directions (count, 3) on a spiral of Fibonacci."""
    index = np.arange(count)
    z = 1.0 - (2.0 * index + 1.0) / count
    angle, flat = index * GOLDEN_ANGLE, np.sqrt(1.0 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def nearest_map(directions: Array) -> NDArray[np.int32]:
    """Index of the nearest of directions (D, 3) in every cell of an octahedron unfolded onto a square."""
    x, y = ((grid + 0.5) / MAP_CELLS * 2.0 - 1.0 for grid in np.mgrid[:MAP_CELLS, :MAP_CELLS])
    z = 1.0 - np.abs(x) - np.abs(y)
    folded = z < 0.0
    x, y = (
        np.where(folded, np.copysign(1.0 - np.abs(y), x), x),
        np.where(folded, np.copysign(1.0 - np.abs(x), y), y),
    )
    cell = np.stack([x, y, z], axis=-1)
    cell /= np.linalg.norm(cell, axis=-1, keepdims=True)
    return np.asarray(cKDTree(directions).query(cell)[1], dtype=np.int32)


@compiled
def find(x: float, y: float, z: float, nearest: NDArray[np.int32]) -> int:
    """Index of the direction near (x, y, z), any length, by the map of ``nearest_map``."""
    size = abs(x) + abs(y) + abs(z)
    u, v = x / size, y / size
    if z < 0.0:
        u, v = np.copysign(1.0 - abs(y / size), x), np.copysign(1.0 - abs(x / size), y)
    cells = len(nearest)
    i = min(int((u + 1.0) * 0.5 * cells), cells - 1)
    j = min(int((v + 1.0) * 0.5 * cells), cells - 1)
    return int(nearest[i, j])
