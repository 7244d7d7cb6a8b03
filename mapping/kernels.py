"""The field's inner loops on a processor: what ``integrate.py`` says in tensors, voxel by voxel."""

import numpy as np
from numpy.typing import NDArray

from polhode.compiled import compiled_fused_ieee
from polhode.lie import Array
from polhode.mapping.blocks import (
    CHANNELS,
    COLOUR,
    COLOUR_WEIGHT,
    DISTANCE,
    EDGE,
    FREE,
    HALF,
    SQUARE,
    VIEWS,
    WEIGHT,
)
from polhode.records import Ints

Floats = NDArray[np.float32]
_EMPTY = -1
_MASK = 2 * HALF - 1
_BITS = HALF.bit_length()
F32 = np.float32
NEAR = (WEIGHT, DISTANCE, SQUARE, VIEWS, COLOUR, COLOUR_WEIGHT)
RESIDUE = 1e-5
"""Of a weight that was taken away: what is left of it is rounding."""


@compiled_fused_ieee
def touched_keys(
    depth: Floats,
    weight: Floats,
    camera: Array,
    X_GR: Array,
    voxel_m: float,
    offsets_m: Array,
    table: Ints,
) -> int:
    """Put the keys of the blocks along each pixel's ray, at its depth plus ``offsets_m``, into a hash table.

    depth, weight (h, w); camera: focal length and centre in the crop [px]; table (a power of two,) of -1.
    Returns how many there are, -1 when the table is half full.
    """
    h, w = depth.shape
    mask, count = len(table) - 1, 0
    edge_m = EDGE * voxel_m
    f, cx, cy = camera
    for step in range(len(offsets_m)):
        last = _EMPTY
        for v in range(h):
            for u in range(w):
                if weight[v, u] <= 0.0:
                    continue
                z = depth[v, u] + offsets_m[step]
                x, y = (u - cx) / f * z, (v - cy) / f * z
                # voxels are round their centres
                a = np.floor(
                    (X_GR[0, 0] * x + X_GR[0, 1] * y + X_GR[0, 2] * z + X_GR[0, 3]) / edge_m + 0.0625
                )
                b = np.floor(
                    (X_GR[1, 0] * x + X_GR[1, 1] * y + X_GR[1, 2] * z + X_GR[1, 3]) / edge_m + 0.0625
                )
                c = np.floor(
                    (X_GR[2, 0] * x + X_GR[2, 1] * y + X_GR[2, 2] * z + X_GR[2, 3]) / edge_m + 0.0625
                )
                if not (abs(a) < HALF - 1 and abs(b) < HALF - 1 and abs(c) < HALF - 1):
                    continue
                key = ((int(a) + HALF) << (2 * _BITS)) | ((int(b) + HALF) << _BITS) | (int(c) + HALF)
                if key == last:
                    continue
                last = key
                slot = ((key * 0x1E3779B97F4A7C15) >> 20) & mask
                while table[slot] != _EMPTY and table[slot] != key:
                    slot = (slot + 1) & mask
                if table[slot] == _EMPTY:
                    table[slot] = key
                    count += 1
                    if 2 * count > mask:
                        return -1
    return count


@compiled_fused_ieee
def update_blocks(
    values: Floats,
    keys: Ints,
    index: Ints,
    voxel_m: float,
    pose: Array,
    camera: Array,
    pixels: Floats,
    cut: Array,
    sign: float,
) -> None:
    """Add a frame to the blocks ``index``, or take it away (sign -1).

    values (n, 512, 7), keys (n,); pose X_RG (4, 4); camera: focal length and centre [px] in ``pixels``
    (h, w, 4): depth, cosine, weight, intensity, whose outermost pixels hold no depth; cut: front, behind [m],
    weight of free space.
    """
    h, w = np.int32(pixels.shape[0]), np.int32(pixels.shape[1])
    flat, cells, none = pixels.reshape(-1, 4), values.reshape(-1, CHANNELS), np.int32(0)
    residue = F32(RESIDUE)
    f, cx, cy = F32(camera[0]), F32(camera[1] + 0.5), F32(camera[2] + 0.5)
    front, behind, free_weight = F32(cut[0]), F32(cut[1]), F32(cut[2])
    solid = F32(behind - 0.5 * voxel_m)
    dx, dy, dz = F32(pose[0, 2] * voxel_m), F32(pose[1, 2] * voxel_m), F32(pose[2, 2] * voxel_m)
    at, depth, plus = np.empty(EDGE, np.int32), np.empty(EDGE, np.float32), F32(sign)
    for n in index:
        key = keys[n]
        a = ((key >> (2 * _BITS)) - HALF) * EDGE
        b = (((key >> _BITS) & _MASK) - HALF) * EDGE
        c = ((key & _MASK) - HALF) * EDGE
        for ij in range(EDGE * EDGE):
            i, j, k = (a + ij // EDGE) * voxel_m, (b + ij % EDGE) * voxel_m, c * voxel_m
            x = F32(pose[0, 0] * i + pose[0, 1] * j + pose[0, 2] * k + pose[0, 3])
            y = F32(pose[1, 0] * i + pose[1, 1] * j + pose[1, 2] * k + pose[1, 3])
            z = F32(pose[2, 0] * i + pose[2, 1] * j + pose[2, 2] * k + pose[2, 3])
            # no branches, and whole numbers clipped: the eight of a row are computed at once
            for m in range(EDGE):
                step = F32(m)
                zm = z + step * dz
                scale = f / zm
                u, v = np.int32((x + step * dx) * scale + cx), np.int32((y + step * dy) * scale + cy)
                u, v = min(max(u, none), np.int32(w - 1)), min(max(v, none), np.int32(h - 1))
                at[m], depth[m] = v * w + u, zm
            for m in range(EDGE):
                # unsigned indices cannot count from the end, and slices are counted: both would cost time
                p = np.uint32(at[m])
                distance = (flat[p, 0] - depth[m]) * flat[p, 1]
                # -inf where the pixel has no depth
                if distance <= -behind:
                    continue
                voxel = np.uint64(n) * np.uint64(EDGE * EDGE * EDGE) + np.uint64(ij * EDGE + m)
                full = plus * flat[p, 2]
                if distance >= front:
                    cells[voxel, FREE] += full * free_weight
                else:
                    grey = flat[p, 3]
                    rise = min(max((grey - F32(8.0)) * F32(1.0 / 40.0), F32(0.0)), F32(1.0))
                    fall = min(max((F32(252.0) - grey) * F32(1.0 / 20.0), F32(0.0)), F32(1.0))
                    part = full * min((distance + behind) / solid, F32(1.0))
                    lit = part * (F32(0.01) + rise * fall)
                    cells[voxel, WEIGHT] += part
                    cells[voxel, DISTANCE] += part * distance
                    cells[voxel, SQUARE] += part * distance * distance
                    cells[voxel, VIEWS] += plus
                    cells[voxel, COLOUR] += lit * grey
                    cells[voxel, COLOUR_WEIGHT] += lit
                if plus < F32(0.0):
                    # what taking away leaves of nothing is zero
                    if cells[voxel, FREE] < -residue * full:
                        cells[voxel, FREE] = F32(0.0)
                    if cells[voxel, VIEWS] < F32(0.5):
                        for channel in NEAR:
                            cells[voxel, channel] = F32(0.0)
