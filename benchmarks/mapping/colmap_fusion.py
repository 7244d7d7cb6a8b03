"""COLMAP's fusion and mesher on depth maps that are given: what of its dense pipeline runs without CUDA.

Its own depth (patch match, Schoenberger et al. 2016) needs CUDA. Its fusion of depth maps into points with
normals and its Poisson mesher (Kazhdan and Hoppe 2013) do not: they read a folder in COLMAP's layout.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose, wxyz_from_matrix
from polhode.records import DepthMap

_STEP_PX = 2
"""Between the points whose differences make a normal."""
_MARKS = 60
"""Points of each frame that tell COLMAP which frames see the same."""
_OCTREE = 10
"""Depth: cells of a thousandth of the body"""
_AGREE = 0.02
"""Of the depth, within which another frame sees such a point."""


def write_workspace(folder: Path, frames: list[tuple[DepthMap, Array]], rig: RectifiedRig) -> None:
    """Images, sparse model, depth and normal maps of frames (depth, X_RG) as COLMAP reads them."""
    for name in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps"):
        (folder / name).mkdir(parents=True)
    names = [f"{k:04d}.png" for k in range(len(frames))]
    for name, (depth, _) in zip(names, frames, strict=True):
        cv2.imwrite(str(folder / "images" / name), depth.intensity)
        z = np.where(np.isfinite(depth.depth_m) & (depth.depth_m > 0), depth.depth_m, 0.0)
        normals = normals_of(z, rig)
        z = np.where(np.any(normals != 0.0, axis=2), z, 0.0)
        _write_map(folder / "stereo" / "depth_maps" / f"{name}.geometric.bin", z[..., None])
        _write_map(folder / "stereo" / "normal_maps" / f"{name}.geometric.bin", normals)
    (folder / "stereo" / "fusion.cfg").write_text("".join(f"{name}\n" for name in names))
    _write_model(folder / "sparse", names, frames, rig)


def normals_of(z: Array, rig: RectifiedRig) -> Array:
    """(H, W, 3) unit normals towards the camera, in its axes, of depth (H, W), 0 where unknown."""
    v, u = np.mgrid[: z.shape[0], : z.shape[1]]
    ray = np.stack(
        [(u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px, np.ones(z.shape)], axis=-1
    )
    inverse = np.where(z > 0, 1.0 / np.maximum(z, 1e-9), np.nan)
    n, out = _STEP_PX, np.zeros((*z.shape, 3))
    # 1/z is linear in the pixels of a plane, and its slope and value are the normal
    du = np.full(z.shape, np.nan)
    dv = du.copy()
    du[:, n:-n] = (inverse[:, 2 * n :] - inverse[:, : -2 * n]) / (2 * n)
    dv[n:-n] = (inverse[2 * n :] - inverse[: -2 * n]) / (2 * n)
    f = rig.focal_px
    normal = np.stack([du * f, dv * f, inverse - du * (u - rig.cx_px) - dv * (v - rig.cy_px)], axis=-1)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    normal *= -np.sign(np.sum(normal * ray, axis=2, keepdims=True))
    known = np.isfinite(normal).all(axis=2)
    out[known] = normal[known]
    return out


def _write_map(path: Path, values: Array) -> None:
    """(H, W, C): a line with the sizes, then floats, one channel after the other."""
    h, w, c = values.shape
    content = np.ascontiguousarray(values.transpose(2, 0, 1), dtype="<f4").tobytes()
    path.write_bytes(f"{w}&{h}&{c}&".encode("ascii") + content)


def _write_model(
    folder: Path, names: list[str], frames: list[tuple[DepthMap, Array]], rig: RectifiedRig
) -> None:
    # COLMAP counts from the corner of a pixel
    camera = f"{rig.focal_px} {rig.focal_px} {rig.cx_px + 0.5} {rig.cy_px + 0.5}"
    (folder / "cameras.txt").write_text(f"1 PINHOLE {rig.width_px} {rig.height_px} {camera}\n")
    seen: list[list[str]] = [[] for _ in frames]
    points, number = [], 0
    rng = np.random.default_rng(0)
    for depth, X_RG in frames:
        v, u = np.nonzero(np.isfinite(depth.depth_m) & (depth.depth_m > 0))
        some = rng.permutation(len(v))[:_MARKS]
        z = depth.depth_m[v[some], u[some]].astype(np.float64)
        p_R = np.stack(
            [(u[some] - rig.cx_px) / rig.focal_px * z, (v[some] - rig.cy_px) / rig.focal_px * z, z], 1
        )
        X_GR = inverse_pose(X_RG)
        p_G = p_R @ X_GR[:3, :3].T + X_GR[:3, 3]
        tracks: list[list[tuple[int, int]]] = [[] for _ in p_G]
        for other, pixels in enumerate(_sights(frames, p_G, rig)):
            for point, (column, row) in pixels.items():
                tracks[point].append((other + 1, len(seen[other])))
                seen[other].append(f"{column + 0.5} {row + 0.5} {number + point + 1}")
        for point, track in enumerate(tracks):
            at = " ".join(str(float(x)) for x in p_G[point])
            points.append(
                f"{number + point + 1} {at} 128 128 128 1 {' '.join(f'{i} {j}' for i, j in track)}\n"
            )
        number += len(p_G)
    (folder / "points3D.txt").write_text("".join(points))
    lines = []
    for k, (name, (_, X_RG)) in enumerate(zip(names, frames, strict=True)):
        q = " ".join(str(float(x)) for x in wxyz_from_matrix(X_RG[:3, :3]))
        t = " ".join(str(float(x)) for x in X_RG[:3, 3])
        lines.append(f"{k + 1} {q} {t} 1 {name}\n{' '.join(seen[k])}\n")
    (folder / "images.txt").write_text("".join(lines))


def _sights(
    frames: list[tuple[DepthMap, Array]], p_G: Array, rig: RectifiedRig
) -> list[dict[int, tuple[int, int]]]:
    """For each frame, the points (n, 3) that its depth agrees with, and their pixels (column, row)."""
    found = []
    for depth, X_RG in frames:
        p = p_G @ X_RG[:3, :3].T + X_RG[:3, 3]
        u = np.rint(rig.focal_px * p[:, 0] / p[:, 2] + rig.cx_px).astype(int)
        v = np.rint(rig.focal_px * p[:, 1] / p[:, 2] + rig.cy_px).astype(int)
        h, w = depth.depth_m.shape
        inside = (p[:, 2] > 0) & (u >= 0) & (u < w) & (v >= 0) & (v < h)
        z = np.where(inside, depth.depth_m[np.where(inside, v, 0), np.where(inside, u, 0)], np.nan)
        near = np.abs(z - p[:, 2]) < _AGREE * p[:, 2]
        found.append({int(n): (int(u[n]), int(v[n])) for n in np.flatnonzero(near)})
    return found


def fuse_and_mesh(pycolmap: Any, folder: Path, least_pixels: int) -> Path:
    """The mesh that COLMAP makes of a workspace: points on which ``least_pixels`` frames agree, then Poisson.

    Of so few points its default, which trims what is sparser than an octree of depth 10, leaves nothing. So
    nothing is trimmed, and the mesh is closed over what nobody saw, too.
    """
    options = pycolmap.StereoFusionOptions()
    options.num_threads, options.min_num_pixels = 1, least_pixels
    points, mesh = folder / "fused.ply", folder / "mesh.ply"
    pycolmap.stereo_fusion(points, folder, input_type="geometric", output_type="ply", options=options)
    poisson = pycolmap.PoissonMeshingOptions()
    poisson.num_threads, poisson.depth, poisson.trim = 1, _OCTREE, 0.0
    pycolmap.poisson_meshing(points, mesh, poisson)
    return mesh
