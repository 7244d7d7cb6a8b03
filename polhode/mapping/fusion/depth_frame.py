"""A depth map prepared for the field: cropped to the target, with the weight of every pixel.

A pixel's weight is the squared cosine of the viewing angle over the variance of its distance along the
normal: of the depth itself, foreshortened, and of the frame's pose.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float32
from torch import Tensor

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array
from polhode.records.surface import DepthMap


@dataclass(frozen=True)
class FrameTensors:
    """A depth map, cropped to the target; images (h, w)."""

    depth_m: Float32[Tensor, "h w"]
    """0 where unknown"""
    weight: Float32[Tensor, "h w"]
    """[1/m^2], 0 where unknown"""
    cosine: Float32[Tensor, "h w"]
    """between viewing ray and surface normal"""
    intensity: Float32[Tensor, "h w"]
    u0: int
    v0: int
    sigma_m: Float32[Tensor, "h w"] | None = None
    """of the depth itself; None: not kept, because ``doubt`` is low and the frame is not aligned"""
    doubt: float = 0.0
    """Median ratio of the distances' sigma by the pose to the depth's own sigma"""

    @property
    def bytes(self) -> int:
        """Memory of the images."""
        return (16 if self.sigma_m is None else 20) * self.depth_m.numel()

    @property
    def own_sigma_m(self) -> Float32[Tensor, "h w"]:
        """``sigma_m``; ValueError where it was not kept."""
        if self.sigma_m is None:
            raise ValueError("the depth's own sigma was not kept")
        return self.sigma_m


def frame_tensors(
    frame: DepthMap,
    rig: RectifiedRig,
    covariance_R: Array | None = None,
    arm_R: Array | None = None,
) -> FrameTensors | None:
    """Crop a depth map; None when it has no depth.

    covariance_R (6, 6): of the target's pose in the rectified camera, translation [m] and rotation [rad] in
    R, the rotation about ``arm_R`` (3,) [m], the origin of G in R; None: exact.
    """
    crop = _box(frame)
    if crop is None:
        return None
    v0, u0 = crop[0].start, crop[1].start
    depth_m, sigma_m = frame.depth_m[crop], frame.sigma_m[crop]
    known = _known(depth_m, sigma_m)
    seen = torch.from_numpy(known)
    depth = torch.from_numpy(np.where(known, depth_m, 0.0).astype(np.float32))
    sigma = torch.from_numpy(np.where(known, sigma_m, 1.0).astype(np.float32))
    normal, ray = _normals(depth, seen, rig, u0, v0)
    cosine = (normal * ray).sum(0).abs().clamp(0.17, 1.0)
    variance, doubt = (sigma * cosine).square(), 0.0
    if covariance_R is not None:
        origin = np.zeros(3) if arm_R is None else arm_R
        of_pose = _pose_variance(depth, normal, ray, covariance_R, origin)
        # pixels used for the median: every seventh
        ratio = (of_pose / variance)[seen][::7]
        doubt = float(ratio.median().sqrt())
        variance = variance + of_pose
    # matching windows see slanted surfaces compressed: their depth is worse than sigma along the normal
    variance = variance / cosine.square()
    return FrameTensors(
        depth_m=depth,
        weight=seen / variance,
        cosine=cosine,
        intensity=torch.from_numpy(frame.intensity[crop].astype(np.float32)),
        u0=u0,
        v0=v0,
        sigma_m=sigma,
        doubt=doubt,
    )


def at_pose(frame: FrameTensors, rig: RectifiedRig, covariance_R: Array, arm_R: Array) -> FrameTensors:
    """The same depth with the weights of another pose; its ``sigma_m`` must have been kept."""
    seen = frame.weight > 0
    normal, ray = _normals(frame.depth_m, seen, rig, frame.u0, frame.v0)
    of_pose = _pose_variance(frame.depth_m, normal, ray, covariance_R, arm_R)
    variance = frame.own_sigma_m.square() + of_pose / frame.cosine.square()
    return replace(frame, weight=seen / variance)


def _known(depth_m: np.ndarray, sigma_m: np.ndarray) -> np.ndarray:
    # a comparison with NaN is false; inf is no depth
    with np.errstate(invalid="ignore"):
        return (depth_m > 0) & (sigma_m > 0) & (depth_m < np.inf) & (sigma_m < np.inf)


def _box(frame: DepthMap) -> tuple[slice, slice] | None:
    """Rows and columns with depth, and a margin."""
    known = _known(frame.depth_m, frame.sigma_m)
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if len(rows) == 0:
        return None
    (height, width), m = known.shape, 8
    return (
        slice(max(int(rows[0]) - m, 0), min(int(rows[-1]) + 1 + m, height)),
        slice(max(int(columns[0]) - m, 0), min(int(columns[-1]) + 1 + m, width)),
    )


def _normals(
    depth: Float32[Tensor, "h w"], seen: Bool[Tensor, "h w"], rig: RectifiedRig, u0: int, v0: int
) -> tuple[Float32[Tensor, "3 h w"], Float32[Tensor, "3 h w"]]:
    """Unit normals and unit viewing rays, from the slope of smoothed inverse depth (planes stay planes)."""
    inverse = torch.where(seen, 1.0 / depth.clamp_min(1e-6), 0.0)

    def box(image: Float32[Tensor, "h w"]) -> Float32[Tensor, "h w"]:
        return F.avg_pool2d(image[None, None], 5, stride=1, padding=2, count_include_pad=True)[0, 0]

    share = box(seen.to(torch.float32))
    smooth = torch.where(share > 0, box(inverse) / share.clamp_min(1e-6), 0.0)
    du = (torch.roll(smooth, -2, 1) - torch.roll(smooth, 2, 1)) / 4
    dv = (torch.roll(smooth, -2, 0) - torch.roll(smooth, 2, 0)) / 4
    whole = share > 0.7
    du, dv = torch.where(whole, du, 0.0), torch.where(whole, dv, 0.0)
    h, w = depth.shape
    x = (torch.arange(w) + u0 - rig.cx_px)[None, :].expand(h, w)
    y = (torch.arange(h) + v0 - rig.cy_px)[:, None].expand(h, w)
    # 1/z = a x + b y + c over pixels: the plane's normal is (a f, b f, c'), c' the value at the centre.
    normal = torch.stack([du * rig.focal_px, dv * rig.focal_px, smooth - du * x - dv * y])
    ray = torch.stack([x, y, torch.full_like(x, rig.focal_px)])
    ray = ray / ray.square().sum(0).sqrt()
    length = normal.square().sum(0).sqrt()
    return torch.where(smooth > 0, normal / length.clamp_min(1e-12), ray), ray


def _pose_variance(
    depth: Float32[Tensor, "h w"],
    normal: Float32[Tensor, "3 h w"],
    ray: Float32[Tensor, "3 h w"],
    covariance_R: Array,
    arm_R: Array,
) -> Float32[Tensor, "h w"]:
    """Variance of the distance along the normal, n . (dt + dtheta x (p - arm)) [m^2]."""
    p = ray / ray[2] * depth
    origin = torch.as_tensor(arm_R, dtype=torch.float32)
    lever = torch.linalg.cross(p - origin[:, None, None], normal, dim=0)
    row = torch.cat([normal, lever])
    S = torch.as_tensor(covariance_R, dtype=torch.float32)
    return (row * torch.einsum("ij,jhw->ihw", S, row)).sum(0).clamp_min(0.0)
