"""The landmarks of the window, in a bounded set of slots that are released when no frame sees them."""

import numpy as np

from polhode.lie import Array
from polhode.records import Ints

FIRST_SLOTS = 1024


class LandmarkSlots:
    """Slot, position in G and covariance of each landmark."""

    def __init__(self) -> None:
        self._slot_of: dict[int, int] = {}
        self._free: list[int] = list(range(FIRST_SLOTS))[::-1]
        self.name: Ints = np.zeros(FIRST_SLOTS, np.int64)
        self.p_G: Array = np.zeros((FIRST_SLOTS, 3))
        self.covariance: Array = np.zeros((FIRST_SLOTS, 3, 3))
        """[m^2] given the poses"""
        self.views: Ints = np.zeros(FIRST_SLOTS, np.int64)
        """number of observations in the frames of the window"""
        self.refused: Ints = np.zeros(FIRST_SLOTS, np.int64)
        """number of contradicting observations since the last one that agreed"""

    def __len__(self) -> int:
        return len(self.p_G)

    @property
    def used(self) -> Ints:
        """Slots in use."""
        return np.flatnonzero(self.views > 0)

    def find(self, names: Ints) -> Ints:
        """Slot of each landmark (m,); -1 if it is not known."""
        return np.array([self._slot_of.get(int(name), -1) for name in names], dtype=np.int64)

    def take(self, names: Ints) -> Ints:
        """Allocate slots (m,) for new landmarks."""
        while len(self._free) < len(names):
            self._grow()
        slots = np.array([self._free.pop() for _ in names], dtype=np.int64)
        self._slot_of.update(zip(names.tolist(), slots.tolist(), strict=True))
        self.name[slots], self.views[slots], self.refused[slots] = names, 0, 0
        return slots

    def leave(self, slots: Ints) -> None:
        """Remove one observation of each; landmarks without observations are forgotten."""
        self.views[slots] -= 1
        for slot in slots[self.views[slots] == 0].tolist():
            del self._slot_of[int(self.name[slot])]
            self._free.append(slot)

    def _grow(self) -> None:
        n = len(self)
        self._free = list(range(n, 2 * n))[::-1] + self._free
        self.name, self.views, self.refused = (
            np.concatenate([a, np.zeros(n, np.int64)]) for a in (self.name, self.views, self.refused)
        )
        self.p_G = np.concatenate([self.p_G, np.zeros((n, 3))])
        self.covariance = np.concatenate([self.covariance, np.zeros((n, 3, 3))])
