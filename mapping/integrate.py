"""One depth map into the field: a weighted, truncated, signed distance along the surface normal.

Curless and Levoy, "A volumetric method for building complex models from range images", 1996, with
weights from what is known of each distance (``frame.py``), a short ramp behind the surface (thin panels) and
carving of what a frame sees through. Sums are kept, so a frame can be taken away again.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float32, Int64
from numpy.typing import NDArray
from torch import Tensor

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose
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
    VOXELS,
    WEIGHT,
    BlockGrid,
    pack_keys,
    unpack_keys,
    voxel_offsets,
)
from polhode.mapping.frame import FrameTensors
from polhode.mapping.kernels import RESIDUE, touched_keys, update_blocks

_CHUNK_BLOCKS = 2048


def allocate(
    grid: BlockGrid, frame: FrameTensors, X_RG: Array, rig: RectifiedRig, in_tensors: bool = False
) -> None:
    """Make the blocks that the frame's truncation band touches; X_RG (4, 4) target in rectified camera.

    On a processor the loops are compiled, unless ``in_tensors``; elsewhere the same is said in tensors.
    """
    near = _blocks_near_surface if in_tensors or grid.device.type != "cpu" else _blocks_touched
    grid.allocate(near(grid, frame, X_RG, rig))


def integrate(
    grid: BlockGrid,
    frame: FrameTensors,
    X_RG: Array,
    rig: RectifiedRig,
    blocks: tuple[int, int] | None = None,
    remove: bool = False,
    in_tensors: bool = False,
) -> None:
    """Add one frame to the blocks from, to (None: all), in place, or take it away."""
    start, stop = blocks if blocks is not None else (0, len(grid))
    if start >= stop:
        return
    pose = torch.as_tensor(X_RG, dtype=torch.float32, device=grid.device)
    index = start + _blocks_in_sight(grid, frame, pose, rig, slice(start, stop))
    if in_tensors or grid.device.type != "cpu":
        _add_in_tensors(grid, index, frame, pose, rig, remove)
        return
    update_blocks(
        grid.values.numpy(),
        grid.keys.numpy(),
        index.numpy(),
        grid.voxel_m,
        np.ascontiguousarray(X_RG),
        _camera(frame, rig) + np.array([0.0, 1.0, 1.0]),
        _framed(frame),
        np.array([grid.cut.front_m, grid.cut.behind_m, grid.cut.free_space_weight]),
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


def _offsets_m(grid: BlockGrid) -> Array:
    """Steps along a ray through the truncation band, half a block apart."""
    front, behind = grid.cut.front_m, grid.cut.behind_m
    steps = max(2, int(np.ceil((front + behind) / (0.5 * EDGE * grid.voxel_m))) + 1)
    return np.linspace(-front, behind, steps)


def _blocks_touched(
    grid: BlockGrid, frame: FrameTensors, X_RG: Array, rig: RectifiedRig
) -> Int64[Tensor, " n"]:
    """Keys of the blocks that the truncation band of any depth pixel touches."""
    size = 1 << 15
    while True:
        table = np.full(size, -1, dtype=np.int64)
        found = touched_keys(
            frame.depth_m.numpy(),
            frame.weight.numpy(),
            _camera(frame, rig),
            np.ascontiguousarray(inverse_pose(X_RG)),
            grid.voxel_m,
            _offsets_m(grid),
            table,
        )
        if found >= 0:
            return torch.from_numpy(np.sort(table[table >= 0]))
        size *= 4


def _blocks_near_surface(
    grid: BlockGrid, frame: FrameTensors, X_RG: Array, rig: RectifiedRig
) -> Int64[Tensor, " n"]:
    """The same in tensors."""
    v, u = torch.nonzero(frame.weight > 0, as_tuple=True)
    z = frame.depth_m[v, u]
    ray = torch.stack(
        [(u + frame.u0 - rig.cx_px) / rig.focal_px, (v + frame.v0 - rig.cy_px) / rig.focal_px], -1
    )
    ray = torch.cat([ray, torch.ones_like(ray[:, :1])], dim=1)
    X_GR = torch.as_tensor(inverse_pose(X_RG), dtype=torch.float32, device=grid.device)
    found = []
    for offset in _offsets_m(grid):
        p_G = (ray * (z + float(offset))[:, None]) @ X_GR[:3, :3].T + X_GR[:3, 3]
        block = torch.floor((torch.round(p_G / grid.voxel_m)) / EDGE)
        block = block[(block.abs() < HALF - 1).all(dim=1)]
        found.append(pack_keys(block.to(torch.int64)).unique())
    keys: Int64[Tensor, " n"] = torch.cat(found).unique()
    return keys


def _blocks_in_sight(
    grid: BlockGrid, frame: FrameTensors, pose: Float32[Tensor, "4 4"], rig: RectifiedRig, which: slice
) -> Int64[Tensor, " n"]:
    """Which of the blocks ``which`` project onto depth and do not lie wholly behind the surface."""
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
    before = p[:, 2] - radius_m <= deepest[row, column] + grid.cut.behind_m
    return torch.nonzero(inside & before, as_tuple=True)[0]


def _add_in_tensors(
    grid: BlockGrid,
    index: Int64[Tensor, " n"],
    frame: FrameTensors,
    pose: Float32[Tensor, "4 4"],
    rig: RectifiedRig,
    remove: bool,
) -> None:
    """Project every voxel of the blocks ``index`` (n,) into the frame; add what it sees, or take it away."""
    offsets = voxel_offsets(grid.device).to(torch.float32) * grid.voxel_m
    sign = -1.0 if remove else 1.0
    for start in range(0, len(index), _CHUNK_BLOCKS):
        part = index[start : start + _CHUNK_BLOCKS]
        _add_part(grid, part, offsets, frame, pose, rig, sign)
        if remove:
            values = grid.values[part]
            taken = float(frame.weight.max())
            values[..., FREE] *= values[..., FREE] > RESIDUE * taken
            values[..., :FREE] *= (values[..., VIEWS] > 0.5)[..., None]
            values[..., VIEWS:] *= (values[..., VIEWS] > 0.5)[..., None]
            grid.values[part] = values


def _add_part(
    grid: BlockGrid,
    index: Int64[Tensor, " n"],
    offsets: Float32[Tensor, "512 3"],
    frame: FrameTensors,
    pose: Float32[Tensor, "4 4"],
    rig: RectifiedRig,
    sign: float,
) -> None:
    cut = grid.cut
    corner = (unpack_keys(grid.keys[index]) * EDGE).to(torch.float32) * grid.voxel_m
    R, t = pose[:3, :3], pose[:3, 3]
    # Rotating corners and offsets apart saves the large product over all voxels.
    p = ((corner @ R.T + t)[:, None, :] + offsets @ R.T).reshape(-1, 3)
    z = p[:, 2]
    h, w = frame.depth_m.shape
    u = torch.floor(rig.focal_px * p[:, 0] / z + (rig.cx_px - frame.u0 + 0.5)).to(torch.int64)
    v = torch.floor(rig.focal_px * p[:, 1] / z + (rig.cy_px - frame.v0 + 0.5)).to(torch.int64)
    hit = torch.nonzero((z > 0) & (u >= 0) & (u < w) & (v >= 0) & (v < h), as_tuple=True)[0]
    pixel = v[hit] * w + u[hit]
    depth = frame.depth_m.reshape(-1)[pixel]
    seen = torch.nonzero(depth > 0, as_tuple=True)[0]
    hit, pixel, depth = hit[seen], pixel[seen], depth[seen]
    distance = (depth - z[hit]) * frame.cosine.reshape(-1)[pixel]
    keep = torch.nonzero(distance > -cut.behind_m, as_tuple=True)[0]
    hit, pixel, distance = hit[keep], pixel[keep], distance[keep]
    weight = sign * frame.weight.reshape(-1)[pixel]

    near = (distance < cut.front_m).to(torch.float32)
    ramp = ((distance + cut.behind_m) / (cut.behind_m - 0.5 * grid.voxel_m)).clamp(0.0, 1.0)
    part = weight * near * ramp
    intensity = frame.intensity.reshape(-1)[pixel]
    lit = part * exposure_weight(intensity)
    added = torch.zeros(len(hit), CHANNELS, device=grid.device)
    added[:, WEIGHT], added[:, DISTANCE] = part, part * distance
    added[:, SQUARE], added[:, VIEWS] = part * distance.square(), sign * near
    added[:, FREE] = weight * (1.0 - near) * cut.free_space_weight
    added[:, COLOUR], added[:, COLOUR_WEIGHT] = lit * intensity, lit
    block = torch.div(hit, VOXELS, rounding_mode="floor")
    grid.values[index[block], hit - block * VOXELS] += added


def exposure_weight(intensity: Float32[Tensor, " n"]) -> Float32[Tensor, " n"]:
    """Trust in an 8-bit intensity: low in shadow and near saturation, never zero."""
    rise = ((intensity - 8.0) / 40.0).clamp(0.0, 1.0)
    fall = ((252.0 - intensity) / 20.0).clamp(0.0, 1.0)
    return 0.01 + rise * fall
