"""The field between its voxels: signed distance, its gradient and its variance, by trilinear weights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.compiled import compiled_fused_ieee
from polhode.lie import Array, transform_points
from polhode.mapping.fusion.block_grid import (
    DISTANCE,
    EDGE,
    FREE,
    HALF,
    SQUARE,
    VIEWS,
    VOXELS,
    WEIGHT,
    BlockGrid,
)
from polhode.records import Ints

_BITS = HALF.bit_length()
_MIN_VIEWS = 2
"""What a single frame saw confirms nothing."""


@dataclass(frozen=True)
class FieldSamples:
    """The surface as seen from points (n, 3) in G; NaN where it is not known."""

    distance_m: Array
    """(n,) signed, positive in front of the surface"""
    gradient_G: Array
    """(n, 3) of the distance, about a unit vector"""
    variance_m2: Array
    """(n,) of the distance"""


@dataclass(frozen=True)
class FieldLookup:
    """A field on the processor, in its frame F, asked at points of G."""

    values: NDArray[np.float32]
    """(n, 512, 7)"""
    keys: Ints
    """(n,) sorted"""
    order: Ints
    """(n,) the blocks of these keys"""
    voxel_m: float
    front_m: float
    carved_share: float
    """Known is where frames that look through have no more of the weight"""
    X_FG: Array
    """(4, 4)"""

    @staticmethod
    def of(grid: BlockGrid, X_FG: Array, carved_share: float) -> "FieldLookup":
        """A view of the field as it is now, not a copy where it is on the processor."""
        keys = grid.keys.cpu().numpy()
        order = np.argsort(keys)
        values = grid.values.cpu().numpy()
        return FieldLookup(values, keys[order], order, grid.voxel_m, grid.cut.front_m, carved_share, X_FG)

    def __call__(self, points_G: Array) -> FieldSamples:
        """points_G (n, 3) [m]; finite."""
        points = np.ascontiguousarray(transform_points(self.X_FG, points_G) / self.voxel_m)
        out = np.full((len(points), 5), np.nan)
        limits = np.array([self.front_m, self.carved_share, self.voxel_m])
        if len(self.keys):
            interpolate(self.values, self.keys, self.order, limits, points, out)
        return FieldSamples(out[:, 0], out[:, 1:4] @ self.X_FG[:3, :3], out[:, 4])


@compiled_fused_ieee
def interpolate(
    values: NDArray[np.float32], keys: Ints, order: Ints, limits: Array, points: Array, out: Array
) -> None:
    """Fill ``out`` (n, 5): distance [m], gradient (3), variance [m^2], at ``points`` (n, 3) [voxels].

    Rows whose eight voxels are not all known stay as they are. limits: front [m], most share of free weight,
    voxel [m].
    """
    front, carved, voxel_m = limits
    cells = values.reshape(-1, values.shape[-1])
    distance, variance = np.empty(8), np.empty(8)
    last_key, last_block = np.int64(-1), np.int64(0)
    for n in range(len(points)):
        low = np.floor(points[n])
        if not np.all(np.abs(low) < EDGE * (HALF - 2)):
            continue
        share, known = points[n] - low, True
        for corner in range(8):
            i = int(low[0]) + (corner >> 2)
            j = int(low[1]) + ((corner >> 1) & 1)
            k = int(low[2]) + (corner & 1)
            # whole numbers are shifted to be positive, so that division rounds down
            a, b, c = i + EDGE * HALF, j + EDGE * HALF, k + EDGE * HALF
            key = ((a // EDGE) << (2 * _BITS)) | ((b // EDGE) << _BITS) | (c // EDGE)
            if key != last_key:
                at = np.searchsorted(keys, key)
                if at >= len(keys) or keys[at] != key:
                    known = False
                    break
                last_key, last_block = np.int64(key), order[at]
            cell = cells[last_block * VOXELS + ((a % EDGE) * EDGE + b % EDGE) * EDGE + c % EDGE]
            weight = float(cell[WEIGHT]) + float(cell[FREE])
            if cell[WEIGHT] <= 0.0 or cell[VIEWS] < _MIN_VIEWS or cell[FREE] > carved * weight:
                known = False
                break
            mean = (cell[DISTANCE] + front * cell[FREE]) / weight
            scatter = (cell[SQUARE] + front * front * cell[FREE]) / weight - mean * mean
            distance[corner] = mean
            # the larger of what the weights promise and what the frames' scatter shows
            variance[corner] = max(1.0 / weight, scatter / cell[VIEWS])
        if not known:
            continue
        out[n] = 0.0
        for corner in range(8):
            x = share[0] if corner & 4 else 1.0 - share[0]
            y = share[1] if corner & 2 else 1.0 - share[1]
            z = share[2] if corner & 1 else 1.0 - share[2]
            out[n, 0] += x * y * z * distance[corner]
            out[n, 1] += (1.0 if corner & 4 else -1.0) * y * z * distance[corner] / voxel_m
            out[n, 2] += (1.0 if corner & 2 else -1.0) * x * z * distance[corner] / voxel_m
            out[n, 3] += (1.0 if corner & 1 else -1.0) * x * y * distance[corner] / voxel_m
            out[n, 4] += x * y * z * variance[corner]
