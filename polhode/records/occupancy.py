"""What the images leave possible around the mesh: a grid of cubes in G."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array

FREE, OUTLINED, POSSIBLE, EMPTY = STATES = 0, 1, 2, 3
"""States of a cell: outside of all that is known; by several frames it holds matter; excluded by no frame;
seen before the sky, where matter would be in light.
"""


@dataclass(frozen=True)
class Occupancy:
    """The states of all cells; beyond the grid everything is free."""

    origin_G: Array
    """(3,) centre of the first cell [m]"""
    step_m: float
    state: NDArray[np.uint8]
    """(nx, ny, nz)"""

    def centres(self, *states: int) -> Array:
        """Centres (n, 3) in G [m] of the cells of these states."""
        return np.asarray(self.origin_G + self.step_m * np.argwhere(np.isin(self.state, states)))

    def states_at(self, p_G: Array) -> NDArray[np.uint8]:
        """States (n,) of the cells that contain points (n, 3)."""
        cell = np.rint((p_G - self.origin_G) / self.step_m).astype(int)
        size = np.array(self.state.shape)
        i, j, k = np.clip(cell, 0, size - 1).T
        return np.where(((cell >= 0) & (cell < size)).all(axis=1), self.state[i, j, k], np.uint8(FREE))
