"""One depth map into the field: a weighted, truncated, signed distance along the surface normal.

Curless and Levoy, "A volumetric method for building complex models from range images", 1996, with
weights from the depth's standard deviation, a short ramp behind the surface (thin panels) and carving of
what a frame sees through.
"""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float32, Int64
from torch import Tensor

from mapping.blocks import EDGE, VOXELS, BlockGrid, pack_keys, unpack_keys, voxel_offsets
from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose
from polhode.records import DepthMap

_CHUNK_BLOCKS = 2048
_MIN_COSINE = 0.17


@dataclass(frozen=True)
class Truncation:
    """Where the field is cut off [m], and how much an empty voxel counts."""

    front_m: float
    behind_m: float
    free_space_weight: float


@dataclass(frozen=True)
class FrameTensors:
    """A depth map on the device, cropped to the target; images (h, w)."""

    depth_m: Float32[Tensor, "h w"]
    """0 where unknown"""
    weight: Float32[Tensor, "h w"]
    """[1/m^2], 0 where unknown"""
    cosine: Float32[Tensor, "h w"]
    """between viewing ray and surface normal"""
    intensity: Float32[Tensor, "h w"]
    background: Bool[Tensor, "h w"]
    """true outside the target's silhouette"""
    u0: int
    v0: int


def frame_tensors(frame: DepthMap, rig: RectifiedRig, device: torch.device) -> FrameTensors | None:
    """Crop and upload a depth map; None when it has no depth."""
    known = (
        np.isfinite(frame.depth_m) & np.isfinite(frame.sigma_m) & (frame.depth_m > 0) & (frame.sigma_m > 0)
    )
    if not known.any():
        return None
    rows, columns = np.nonzero(known.any(axis=1))[0], np.nonzero(known.any(axis=0))[0]
    margin = 8
    v0, v1 = max(rows[0] - margin, 0), min(rows[-1] + 1 + margin, known.shape[0])
    u0, u1 = max(columns[0] - margin, 0), min(columns[-1] + 1 + margin, known.shape[1])
    crop = (slice(v0, v1), slice(u0, u1))
    seen = torch.from_numpy(known[crop]).to(device)
    depth = torch.from_numpy(np.where(known, frame.depth_m, 0.0)[crop].astype(np.float32)).to(device)
    sigma = torch.from_numpy(np.where(known, frame.sigma_m, 1.0)[crop].astype(np.float32)).to(device)
    cosine = _cosine_of_incidence(depth, seen, rig, int(u0), int(v0))
    return FrameTensors(
        depth_m=depth,
        weight=seen / (sigma * cosine).square(),
        cosine=cosine,
        intensity=torch.from_numpy(frame.intensity[crop].astype(np.float32)).to(device),
        background=torch.from_numpy(~frame.target[crop]).to(device),
        u0=int(u0),
        v0=int(v0),
    )


def _cosine_of_incidence(
    depth: Float32[Tensor, "h w"], seen: Bool[Tensor, "h w"], rig: RectifiedRig, u0: int, v0: int
) -> Float32[Tensor, "h w"]:
    """Cosine between ray and normal (h, w), from the slope of smoothed inverse depth (planes stay planes)."""
    inverse = torch.where(seen, 1.0 / depth.clamp_min(1e-6), 0.0)
    filled = seen.to(torch.float32)

    def box(image: Float32[Tensor, "h w"]) -> Float32[Tensor, "h w"]:
        return F.avg_pool2d(image[None, None], 5, stride=1, padding=2, count_include_pad=True)[0, 0]

    share = box(filled)
    smooth = torch.where(share > 0, box(inverse) / share.clamp_min(1e-6), 0.0)
    du = (torch.roll(smooth, -2, 1) - torch.roll(smooth, 2, 1)) / 4
    dv = (torch.roll(smooth, -2, 0) - torch.roll(smooth, 2, 0)) / 4
    whole = share > 0.7
    du, dv = torch.where(whole, du, 0.0), torch.where(whole, dv, 0.0)
    h, w = depth.shape
    x = (torch.arange(w, device=depth.device) + u0 - rig.cx_px)[None, :]
    y = (torch.arange(h, device=depth.device) + v0 - rig.cy_px)[:, None]
    # 1/z = a x + b y + c over pixels: the plane's normal is (a f, b f, c'), c' the value at the centre.
    nx, ny, nz = du * rig.focal_px, dv * rig.focal_px, smooth - du * x - dv * y
    ray = torch.sqrt(x.square() + y.square() + rig.focal_px**2)
    along = (nx * x + ny * y + nz * rig.focal_px).abs() / ray
    length = torch.sqrt(nx.square() + ny.square() + nz.square()).clamp_min(1e-12)
    return torch.where(smooth > 0, along / length, 1.0).clamp(_MIN_COSINE, 1.0)


def integrate(grid: BlockGrid, frame: FrameTensors, X_RG: Array, rig: RectifiedRig, cut: Truncation) -> None:
    """Update the field in place with one frame; X_RG (4, 4) the target's pose in the rectified camera."""
    grid.allocate(_blocks_near_surface(frame, X_RG, rig, grid.voxel_m, cut, grid.device))
    pose = torch.as_tensor(X_RG, dtype=torch.float32, device=grid.device)
    index = _blocks_in_sight(grid, frame, pose, rig, cut)
    offsets = voxel_offsets(grid.device)
    for start in range(0, len(index), _CHUNK_BLOCKS):
        _update(grid, index[start : start + _CHUNK_BLOCKS], offsets, frame, pose, rig, cut)


def _blocks_near_surface(
    frame: FrameTensors, X_RG: Array, rig: RectifiedRig, voxel_m: float, cut: Truncation, device: torch.device
) -> Int64[Tensor, " n"]:
    """Keys of the blocks that the truncation band of any depth pixel touches."""
    v, u = torch.nonzero(frame.weight > 0, as_tuple=True)
    z = frame.depth_m[v, u]
    ray = torch.stack(
        [(u + frame.u0 - rig.cx_px) / rig.focal_px, (v + frame.v0 - rig.cy_px) / rig.focal_px], -1
    )
    ray = torch.cat([ray, torch.ones_like(ray[:, :1])], dim=1)
    X_GR = torch.as_tensor(inverse_pose(X_RG), dtype=torch.float32, device=device)
    steps = max(2, int(np.ceil((cut.front_m + cut.behind_m) / (0.5 * EDGE * voxel_m))) + 1)
    found = []
    for offset in np.linspace(-cut.front_m, cut.behind_m, steps):
        p_G = (ray * (z + float(offset))[:, None]) @ X_GR[:3, :3].T + X_GR[:3, 3]
        voxel = torch.round(p_G / voxel_m).to(torch.int64)
        found.append(pack_keys(torch.div(voxel, EDGE, rounding_mode="floor")).unique())
    keys: Int64[Tensor, " n"] = torch.cat(found).unique()
    return keys


def _blocks_in_sight(
    grid: BlockGrid, frame: FrameTensors, pose: Float32[Tensor, "4 4"], rig: RectifiedRig, cut: Truncation
) -> Int64[Tensor, " n"]:
    """Indices of blocks that project into the crop and do not lie wholly behind the surface."""
    p = grid.centres_m() @ pose[:3, :3].T + pose[:3, 3]
    z = p[:, 2].clamp_min(1e-6)
    radius_m = 0.5 * EDGE * grid.voxel_m * 3**0.5
    u = rig.focal_px * p[:, 0] / z + rig.cx_px - frame.u0
    v = rig.focal_px * p[:, 1] / z + rig.cy_px - frame.v0
    reach = rig.focal_px * radius_m / z
    h, w = frame.depth_m.shape
    inside = (p[:, 2] > radius_m) & (u > -reach) & (u < w + reach) & (v > -reach) & (v < h + reach)
    cell = max(4, int(torch.ceil(reach[inside].max()).item()) if bool(inside.any()) else 4)
    deepest = F.max_pool2d(frame.depth_m[None, None], cell, stride=cell, ceil_mode=True)
    deepest = F.max_pool2d(deepest, 3, stride=1, padding=1)[0, 0]
    row = (v / cell).long().clamp(0, deepest.shape[0] - 1)
    column = (u / cell).long().clamp(0, deepest.shape[1] - 1)
    limit = deepest[row, column]
    behind = (limit > 0) & (p[:, 2] - radius_m > limit + cut.behind_m)
    return torch.nonzero(inside & ~behind, as_tuple=True)[0]


def _update(
    grid: BlockGrid,
    index: Int64[Tensor, " n"],
    offsets: Int64[Tensor, "512 3"],
    frame: FrameTensors,
    pose: Float32[Tensor, "4 4"],
    rig: RectifiedRig,
    cut: Truncation,
) -> None:
    """Project every voxel of the blocks ``index`` into the frame and add what it sees."""
    corner = (unpack_keys(grid.keys[index]) * EDGE).to(torch.float32) * grid.voxel_m
    R, t = pose[:3, :3], pose[:3, 3]
    # Rotating corners and offsets apart saves the large product over all voxels.
    p = ((corner @ R.T + t)[:, None, :] + (offsets.to(torch.float32) * grid.voxel_m) @ R.T).reshape(-1, 3)
    z = p[:, 2]
    h, w = frame.depth_m.shape
    u = torch.round(rig.focal_px * p[:, 0] / z + (rig.cx_px - frame.u0)).to(torch.int64)
    v = torch.round(rig.focal_px * p[:, 1] / z + (rig.cy_px - frame.v0)).to(torch.int64)
    hit = torch.nonzero((z > 0) & (u >= 0) & (u < w) & (v >= 0) & (v < h), as_tuple=True)[0]
    pixel = v[hit] * w + u[hit]
    depth = frame.depth_m.reshape(-1)[pixel]
    seen = torch.nonzero(depth > 0, as_tuple=True)[0]
    hit, pixel, depth = hit[seen], pixel[seen], depth[seen]
    distance = (depth - z[hit]) * frame.cosine.reshape(-1)[pixel]
    keep = torch.nonzero(distance > -cut.behind_m, as_tuple=True)[0]
    hit, pixel, distance = hit[keep], pixel[keep], distance[keep]
    weight = frame.weight.reshape(-1)[pixel]

    near = distance < cut.front_m
    ramp = ((distance + cut.behind_m) / (cut.behind_m - 0.5 * grid.voxel_m)).clamp(0.0, 1.0)
    weight = weight * torch.where(near, ramp, torch.full_like(ramp, cut.free_space_weight))
    distance = distance.clamp(max=cut.front_m)
    flat = torch.div(hit, VOXELS, rounding_mode="floor")
    at = (index[flat], hit - flat * VOXELS)
    channels = grid.channels

    def add(name: str, values: Float32[Tensor, " k"]) -> None:
        channels[name][at] += values

    add("weight", weight)
    add("weighted_distance", weight * distance)
    add("weighted_square", weight * distance.square())
    add("free", torch.where(near, torch.zeros_like(weight), weight))
    add("views", near.to(torch.float32))
    intensity = frame.intensity.reshape(-1)[pixel]
    lit = weight * near * exposure_weight(intensity)
    add("colour", lit * intensity)
    add("colour_weight", lit)


def exposure_weight(intensity: Float32[Tensor, " n"]) -> Float32[Tensor, " n"]:
    """Trust in an 8-bit intensity: low in shadow and near saturation, never zero."""
    rise = ((intensity - 8.0) / 40.0).clamp(0.0, 1.0)
    fall = ((252.0 - intensity) / 20.0).clamp(0.0, 1.0)
    return 0.01 + rise * fall
