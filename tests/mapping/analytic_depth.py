"""Depth maps of analytic solids for the tests of the fusion: rays cast by trimesh, noise by a seed."""

import numpy as np
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.records.surface import DepthMap

RIG = RectifiedRig(focal_px=240.0, cx_px=79.5, cy_px=59.5, baseline_m=0.09, width_px=160, height_px=120)
FINE_RIG = RectifiedRig(
    focal_px=480.0, cx_px=159.5, cy_px=119.5, baseline_m=0.09, width_px=320, height_px=240
)
DISTANCE_M = 0.6


def depth_of(
    mesh: trimesh.Trimesh, X_RG: Array, sigma_m: float, rng: np.random.Generator, rig: RectifiedRig = RIG
) -> DepthMap:
    """Noisy depth of a mesh given in G, seen from the rectified camera."""
    v, u = np.mgrid[: rig.height_px, : rig.width_px]
    rays = np.stack(
        [(u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px, np.ones(u.shape)], -1
    ).reshape(-1, 3)
    X_GR = inverse_pose(X_RG)
    directions = rays @ X_GR[:3, :3].T
    origins = np.broadcast_to(X_GR[:3, 3], directions.shape)
    face = RayMeshIntersector(mesh).intersects_first(origins, directions)
    hit = face >= 0
    normal, corner = mesh.face_normals[face[hit]], mesh.triangles[face[hit], 0]
    depth = np.full(len(rays), np.nan)
    depth[hit] = np.sum((corner - origins[hit]) * normal, 1) / np.sum(directions[hit] * normal, 1)
    depth = depth.reshape(v.shape) + rng.normal(0.0, sigma_m, v.shape)
    seen = np.isfinite(depth)
    return DepthMap(
        depth_m=depth.astype(np.float32),
        sigma_m=np.where(seen, sigma_m, np.nan).astype(np.float32),
        intensity=np.where(seen, 150, 0).astype(np.uint8),
        target=seen,
    )


def views_of(
    mesh: trimesh.Trimesh, count: int, sigma_m: float, seed: int = 0, rig: RectifiedRig = RIG
) -> list[tuple[DepthMap, Array]]:
    """Depth maps from directions spread over the sphere."""
    rng = np.random.default_rng(seed)
    # Fibonacci directions: every side is seen equally often.
    k = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    frames = []
    for a, b in zip(polar, azimuth, strict=True):
        R = exp_so3([a, 0.0, 0.0]) @ exp_so3([0.0, 0.0, b])
        X_RG = make_pose(R, [0.0, 0.0, DISTANCE_M])
        frames.append((depth_of(mesh, X_RG, sigma_m, rng, rig), X_RG))
    return frames
