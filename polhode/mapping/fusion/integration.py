"""Integration of a frame into the field: blocks near its surface are allocated, all visible voxels updated.

After Curless and Levoy, SIGGRAPH 1996, in compiled loops.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float32, Int64
from numpy.typing import NDArray
from torch import Tensor

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, inverse_pose
from polhode.mapping.fusion.block_grid import (
    CHANNELS,
    COLOUR,
    COLOUR_WEIGHT,
    DISTANCE,
    EDGE,
    FREE,
    FREE_SPACE_WEIGHT,
    HALF,
    SQUARE,
    VIEWS,
    WEIGHT,
    WEIGHT_SQUARED,
    BlockGrid,
)
from polhode.mapping.fusion.depth_frame import FrameTensors
from polhode.runtime.compiled import compiled_fused_ieee

Floats = NDArray[np.float32]
F32 = np.float32
_EMPTY = -1
_MASK = 2 * HALF - 1
_BITS = HALF.bit_length()
NEAR = (WEIGHT, DISTANCE, SQUARE, VIEWS, COLOUR, COLOUR_WEIGHT, WEIGHT_SQUARED)
RESIDUE = 1e-5
"""Share of a removed weight below which the remainder is rounding."""


def allocate(grid: BlockGrid, frame: FrameTensors, X_RG: Array, rig: RectifiedRig) -> None:
    """Allocate the blocks that the frame's truncation band touches; X_RG (4, 4) of the target."""
    # steps along a ray through the truncation band, half a block apart
    front, behind = grid.front_m, grid.behind_m
    steps = max(2, int(np.ceil((front + behind) / (0.5 * EDGE * grid.voxel_m))) + 1)
    offsets_m, size = np.linspace(-front, behind, steps), 1 << 15
    while True:
        table = np.full(size, _EMPTY, dtype=np.int64)
        found = touched_keys(
            frame.depth_m.numpy(),
            frame.weight.numpy(),
            _camera(frame, rig),
            np.ascontiguousarray(inverse_pose(X_RG)),
            grid.voxel_m,
            offsets_m,
            table,
        )
        if found >= 0:
            grid.allocate(torch.from_numpy(np.sort(table[table >= 0])))
            return
        size *= 4


def integrate(
    grid: BlockGrid,
    frame: FrameTensors,
    X_RG: Array,
    rig: RectifiedRig,
    blocks: tuple[int, int] | None = None,
    remove: bool = False,
) -> None:
    """Add one frame to the blocks (first, end), None: all, in place, or remove it."""
    start, stop = blocks if blocks is not None else (0, len(grid))
    if start >= stop:
        return
    pose = torch.as_tensor(X_RG, dtype=torch.float32)
    index = start + _visible_blocks(grid, frame, pose, rig, slice(start, stop))
    update_blocks(
        grid.values.numpy(),
        grid.keys.numpy(),
        index.numpy(),
        grid.voxel_m,
        np.ascontiguousarray(X_RG),
        _camera(frame, rig) + np.array([0.0, 1.0, 1.0]),
        _framed(frame),
        np.array([grid.front_m, grid.behind_m, FREE_SPACE_WEIGHT]),
        -1.0 if remove else 1.0,
    )


def _camera(frame: FrameTensors, rig: RectifiedRig) -> Array:
    """Focal length and centre [px] in the crop."""
    return np.array([rig.focal_px, rig.cx_px - frame.u0, rig.cy_px - frame.v0])


def _framed(frame: FrameTensors) -> NDArray[np.float32]:
    """(h + 2, w + 2, 4): depth, cosine, weight, intensity; -inf, 1, 0, 0 without depth and around."""
    h, w = frame.depth_m.shape
    out = np.zeros((h + 2, w + 2, 4), dtype=np.float32)
    out[..., 0], out[..., 1] = -np.inf, 1.0
    known = (frame.weight > 0).numpy()
    for channel, image in enumerate((frame.depth_m, frame.cosine, frame.weight, frame.intensity)):
        np.copyto(out[1:-1, 1:-1, channel], image.numpy(), where=known)
    return out


def _visible_blocks(
    grid: BlockGrid, frame: FrameTensors, pose: Float32[Tensor, "4 4"], rig: RectifiedRig, which: slice
) -> Int64[Tensor, " n"]:
    """Indices within ``which`` of blocks that project onto depth and are not all behind the surface."""
    p = grid.centres_m(which) @ pose[:3, :3].T + pose[:3, 3]
    z = p[:, 2].clamp_min(1e-6)
    radius_m = 0.5 * EDGE * grid.voxel_m * 3**0.5
    u = rig.focal_px * p[:, 0] / z + rig.cx_px - frame.u0
    v = rig.focal_px * p[:, 1] / z + rig.cy_px - frame.v0
    reach = rig.focal_px * radius_m / z
    h, w = frame.depth_m.shape
    far = p[:, 2] > radius_m
    inside = far & (u > -reach) & (u < w + reach) & (v > -reach) & (v < h + reach)
    cell = max(4, int(torch.ceil(reach[inside].max()).item()) if bool(inside.any()) else 4)
    deepest = F.max_pool2d(frame.depth_m[None, None], cell, stride=cell, ceil_mode=True)
    deepest = F.max_pool2d(deepest, 3, stride=1, padding=1)[0, 0]
    row = (v / cell).long().clamp(0, deepest.shape[0] - 1)
    column = (u / cell).long().clamp(0, deepest.shape[1] - 1)
    # where there is no depth around it is 0, and everything lies behind it
    before = p[:, 2] - radius_m <= deepest[row, column] + grid.behind_m
    return torch.nonzero(inside & before, as_tuple=True)[0]


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
                # a voxel extends half its edge around its centre
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
    """Add a frame to the blocks ``index``, or remove it (sign -1).

    values (n, 512, 8), keys (n,); pose X_RG (4, 4); camera: focal length and centre [px] in ``pixels``
    (h, w, 4): depth, cosine, weight, intensity, no depth in the outermost pixels; cut: front, behind [m],
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
            # without branches, indices clipped, so that the eight of a row are vectorized
            for m in range(EDGE):
                step = F32(m)
                zm = z + step * dz
                scale = f / zm
                u, v = np.int32((x + step * dx) * scale + cx), np.int32((y + step * dy) * scale + cy)
                u, v = min(max(u, none), np.int32(w - 1)), min(max(v, none), np.int32(h - 1))
                at[m], depth[m] = v * w + u, zm
            for m in range(EDGE):
                # unsigned indices avoid the wrap-around of negative ones; slices would be slower
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
                    cells[voxel, WEIGHT_SQUARED] += plus * part * part
                if plus < F32(0.0):
                    # removal leaves rounding, which is set to zero
                    if cells[voxel, FREE] < -residue * full:
                        cells[voxel, FREE] = F32(0.0)
                    if cells[voxel, VIEWS] < F32(0.5):
                        for channel in NEAR:
                            cells[voxel, channel] = F32(0.0)
