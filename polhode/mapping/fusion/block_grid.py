"""A sparse voxel field: cubes of 8 x 8 x 8 voxels, allocated around the surface only.

Voxel (i, j, k) of block (a, b, c) has its centre at ``voxel_m * (8 * [a, b, c] + [i, j, k])`` in G.
"""

from contextlib import suppress

import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch import Tensor

EDGE = 8
VOXELS = EDGE**3
_BITS = 20
HALF = 1 << (_BITS - 1)
"""Block coordinates lie within +-HALF."""

WEIGHT, DISTANCE, SQUARE, FREE, VIEWS, COLOUR, COLOUR_WEIGHT, WEIGHT_SQUARED = range(8)
CHANNELS = 8
BYTES_PER_BLOCK = VOXELS * 4 * CHANNELS


TRUNCATION_VOXELS = 4.0
"""Truncation distance in front of the surface."""
FREE_SPACE_WEIGHT = 0.4
"""Weight of the observation that space is empty far in front of a surface, over that of a surface."""


def pack_keys(block: Int64[Tensor, "n 3"]) -> Int64[Tensor, " n"]:
    """Block coordinates (n, 3) int64, each within +-2^19 -> keys (n,) int64 in lexicographic order."""
    shifted = block + HALF
    return (shifted[:, 0] << (2 * _BITS)) | (shifted[:, 1] << _BITS) | shifted[:, 2]


def unpack_keys(keys: Int64[Tensor, " n"]) -> Int64[Tensor, "n 3"]:
    """Keys (n,) -> block coordinates (n, 3)."""
    mask = (1 << _BITS) - 1
    return torch.stack([keys >> (2 * _BITS), (keys >> _BITS) & mask, keys & mask], dim=1) - HALF


class BlockGrid:
    """Blocks in the order of their allocation: keys (n,), and float32 values (n, 512, 8).

    Memory grows with the blocks, up to ``memory_mib``; while it grows, old and new values exist together.

    Of frames that saw the surface near a voxel: WEIGHT, DISTANCE, SQUARE, sums of w, w d, w d^2, d the signed
    distance [m]; WEIGHT_SQUARED, sum of w^2; VIEWS, their number; COLOUR, COLOUR_WEIGHT, weighted sum of
    intensities and of its weights.
    FREE: sum of the weights of frames that saw through it, at the truncation distance in front.
    """

    def __init__(self, voxel_m: float, memory_mib: float) -> None:
        self.voxel_m = voxel_m
        # Truncation distance behind the surface; short, so that the two sides of a thin panel do not mix
        self.front_m, self.behind_m = TRUNCATION_VOXELS * voxel_m, 3.0 * voxel_m
        self.most = max(1, int(memory_mib * 2**20 / BYTES_PER_BLOCK))
        self.refused = 0
        """Blocks that did not fit in the memory"""
        self._n = 0
        self._values = self._empty(0)
        self._keys = torch.zeros(0, dtype=torch.int64)
        self._sorted = self._keys[:0]
        self._order = self._keys[:0]

    def _empty(self, blocks: int) -> Float32[Tensor, "n 512 8"]:
        # NumPy's zeros take no memory until they are touched
        return torch.from_numpy(np.zeros((blocks, VOXELS, CHANNELS), dtype=np.float32))

    def _reserve(self, blocks: int) -> None:
        """Reserve memory for all blocks that there may ever be, so that none is copied; where memory that is
        not touched counts too, for these, growing by half at least, so that copies are rare."""
        room = len(self._values)
        if blocks <= room:
            return
        # blocks, 16 MiB
        grown = min(self.most, max(blocks, room + room // 2, 1024))
        values = None
        if room == 0:
            with suppress(MemoryError):
                values = self._empty(self.most)
        values = self._empty(grown) if values is None else values
        keys = torch.zeros(len(values), dtype=torch.int64)
        values[: self._n], keys[: self._n] = self.values, self.keys
        self._values, self._keys = values, keys

    def __len__(self) -> int:
        return self._n

    @property
    def keys(self) -> Int64[Tensor, " n"]:
        """(n,)"""
        return self._keys[: self._n]

    @property
    def values(self) -> Float32[Tensor, "n 512 8"]:
        """(n, 512, 8), a view that may be written to, valid until the next ``allocate``."""
        return self._values[: self._n]

    @property
    def bytes(self) -> int:
        """Memory of the values."""
        return len(self) * BYTES_PER_BLOCK

    def find(self, keys: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
        """Indices (m,) of the blocks of these keys, -1 where there is none."""
        if self._n == 0:
            return torch.full_like(keys, -1)
        at = torch.searchsorted(self._sorted, keys).clamp_max(self._n - 1)
        return torch.where(self._sorted[at] == keys, self._order[at], -1)

    def allocate(self, keys: Int64[Tensor, " m"]) -> None:
        """Add empty blocks of the new ones among unique ``keys`` (m,), up to the limit of the memory."""
        new = keys[self.find(keys) < 0]
        self.refused += max(0, len(new) - (self.most - self._n))
        new = new[: self.most - self._n]
        if len(new) == 0:
            return
        self._reserve(self._n + len(new))
        self._keys[self._n : self._n + len(new)] = new
        self._n += len(new)
        self._sorted, self._order = torch.sort(self.keys)

    def centres_m(self, which: slice = slice(None)) -> Float32[Tensor, "n 3"]:
        """(n, 3) float32: the blocks' centres in G [m]."""
        corner = unpack_keys(self.keys[which]) * EDGE
        return (corner.to(torch.float32) + (EDGE - 1) / 2) * self.voxel_m
