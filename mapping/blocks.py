"""A sparse voxel field: cubes of 8 x 8 x 8 voxels, allocated around the surface only.

Voxel (i, j, k) of block (a, b, c) has its centre at ``voxel_m * (8 * [a, b, c] + [i, j, k])`` in G.
Blocks are kept sorted by key, so a block is found by bisection and the result does not depend on the
order in which blocks were asked for.
"""

import torch
from jaxtyping import Float32, Int64
from torch import Tensor

EDGE = 8
VOXELS = EDGE**3
_BITS = 20
_HALF = 1 << (_BITS - 1)

CHANNELS = ("weight", "weighted_distance", "weighted_square", "free", "views", "colour", "colour_weight")
BYTES_PER_BLOCK = VOXELS * 4 * len(CHANNELS)


def pack_keys(block: Int64[Tensor, "n 3"]) -> Int64[Tensor, " n"]:
    """Block coordinates (n, 3) int64, each within +-2^19 -> keys (n,) int64 in lexicographic order."""
    shifted = block + _HALF
    return (shifted[:, 0] << (2 * _BITS)) | (shifted[:, 1] << _BITS) | shifted[:, 2]


def unpack_keys(keys: Int64[Tensor, " n"]) -> Int64[Tensor, "n 3"]:
    """Keys (n,) -> block coordinates (n, 3)."""
    mask = (1 << _BITS) - 1
    return torch.stack([keys >> (2 * _BITS), (keys >> _BITS) & mask, keys & mask], dim=1) - _HALF


def voxel_offsets(device: torch.device) -> Int64[Tensor, "512 3"]:
    """(512, 3) int64: voxel indices inside a block, last axis fastest."""
    axis = torch.arange(EDGE, device=device)
    return torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1).reshape(-1, 3)


class BlockGrid:
    """The blocks' keys (n,), ascending, and one (n, 512) float32 array per channel.

    weight, weighted_distance, weighted_square: sums of w, w d, w d^2 over frames, d the signed distance [m];
    free: sum of the weights of frames that saw through the voxel; views: frames that saw the surface here;
    colour, colour_weight: weighted sum of intensities and of its weights.
    """

    def __init__(self, voxel_m: float, device: torch.device) -> None:
        self.voxel_m = voxel_m
        self.device = device
        self.keys = torch.empty(0, dtype=torch.int64, device=device)
        self.channels = {name: torch.empty(0, VOXELS, device=device) for name in CHANNELS}

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def bytes(self) -> int:
        """Memory of the channels."""
        return len(self) * BYTES_PER_BLOCK

    def allocate(self, keys: Int64[Tensor, " m"]) -> None:
        """Add empty blocks where ``keys`` (m,) names new ones."""
        new = keys[~torch.isin(keys, self.keys)].unique()
        if len(new) == 0:
            return
        merged = torch.cat([self.keys, new])
        order = torch.argsort(merged)
        self.keys = merged[order]
        for name, values in self.channels.items():
            padded = torch.cat([values, values.new_zeros(len(new), VOXELS)])
            self.channels[name] = padded[order]

    def centres_m(self) -> Float32[Tensor, "n 3"]:
        """(n, 3) float32: the blocks' centres in G [m]."""
        corner = unpack_keys(self.keys) * EDGE
        return (corner.to(torch.float32) + (EDGE - 1) / 2) * self.voxel_m
