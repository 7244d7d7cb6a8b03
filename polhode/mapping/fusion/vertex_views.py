"""What each frame says about each vertex: how far its depth is from it, with which weight, from which side.

The field keeps sums over frames, so it cannot tell which frames saw a vertex, nor from where. The depth maps
that are kept can: every vertex is projected into each of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose
from polhode.mapping.fusion.depth_frame import FrameTensors
from polhode.runtime.compiled import compiled_fused_ieee

BEHIND = -0.3
"""It sees the vertex from behind, and so another surface, when the cosine is smaller."""
FADING_RAD = np.deg2rad(20.0)
"""Errors of two frames at one vertex correlate by exp(-angle between their views / this)."""
_CHUNK = 100_000
"""Vertices at a time: 25 MB."""
Floats = NDArray[np.float32]
Seen = tuple[FrameTensors, Array]
"""A frame, and the pose (4, 4) of the vertices' frame in the rectified camera."""


@dataclass(frozen=True)
class VertexViews:
    """Sums over the frames whose depth is near each vertex."""

    weight: Array
    """(V,) sum of the weights [1/m^2]"""
    shared_m: Array
    """(V,) sigma of the weighted mean [m] if errors as large as stated correlate as their views do; inf: no
    frame"""
    front_weight: Array
    """(V,) of the frames that face the vertex [1/m^2]"""
    front_m: Array
    """(V,) their mean signed distance from the vertex, positive: their surface lies inside [m]"""
    front_chi2: Array
    """(V,) weighted squares of their distances from that mean: about one less than their number if they
    scatter as much as stated"""
    front_count: Array
    """(V,) their number"""
    back_share: Array
    """(V,) share of the weight of frames that see it from behind"""


def views_of_vertices(
    frames: Sequence[Seen],
    rig: RectifiedRig,
    vertices: Array,
    normals: Array,
    cut_m: tuple[float, float],
    voxel_m: float,
) -> VertexViews:
    """Project the vertices (V, 3) with their normals (V, 3) into the frames.

    A frame counts where the vertex is at most ``cut_m`` in front of its depth and behind it, as in the field.
    """
    count = len(vertices)
    sums, shared = np.zeros((count, 6)), np.full(count, np.inf)
    group, correlation = _directions([X for _, X in frames], vertices.mean(axis=0) if count else np.zeros(3))
    p, n = vertices.astype(np.float32), normals.astype(np.float32)
    images = [tuple(_image(one) for one in (t.depth_m, t.weight, t.cosine)) for t, _ in frames]
    for start in range(0, count, _CHUNK):
        part = slice(start, min(start + _CHUNK, count))
        roots = np.zeros((part.stop - part.start, len(correlation)), dtype=np.float32)
        for k, (tensors, X) in enumerate(frames):
            depth, weight, cosine = images[k]
            camera = np.array([rig.focal_px, rig.cx_px - tensors.u0 + 0.5, rig.cy_px - tensors.v0 + 0.5])
            cut = np.array([cut_m[0], cut_m[1], cut_m[1] - 0.5 * voxel_m])
            pose = np.ascontiguousarray(X)
            add_view(
                p[part], n[part], depth, weight, cosine, pose, camera, cut, sums[part], roots[:, group[k]]
            )
        seen = sums[part, 0] > 0.0
        mixed = np.einsum("nk,nk->n", roots[seen] @ correlation, roots[seen])
        shared[part][seen] = np.sqrt(mixed) / sums[part, 0][seen]
    total, front, moment, square, number, back = (np.ascontiguousarray(column) for column in sums.T)
    front_m = moment / np.maximum(front, 1e-30)
    return VertexViews(
        weight=total,
        shared_m=shared,
        front_weight=front,
        front_m=front_m,
        front_chi2=np.maximum(square - front * front_m**2, 0.0),
        front_count=number,
        back_share=back / np.maximum(total, 1e-30),
    )


def _image(tensor: torch.Tensor) -> Floats:
    return np.ascontiguousarray(tensor.numpy())


def _directions(poses: Sequence[Array], centre: Array) -> tuple[NDArray[np.int64], Floats]:
    """The group (F,) of each frame's direction of view, and the correlation (K, K) of groups."""
    if not poses:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 0), dtype=np.float32)
    towards = np.array([inverse_pose(X)[:3, 3] for X in poses]) - centre
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    chosen, nearest = [0], towards @ towards[0]
    # frames whose views differ least are counted as one direction
    while len(chosen) < min(64, len(poses)):
        chosen.append(int(np.argmin(nearest)))
        nearest = np.maximum(nearest, towards @ towards[chosen[-1]])
    between = towards @ towards[chosen].T
    angle = np.arccos(np.clip(between[chosen], -1.0, 1.0))
    np.fill_diagonal(angle, 0.0)
    return np.argmax(between, axis=1), np.exp(-angle / FADING_RAD).astype(np.float32)


@compiled_fused_ieee
def add_view(
    vertices: Floats,
    normals: Floats,
    depth: Floats,
    weight: Floats,
    cosine: Floats,
    pose: Array,
    camera: Array,
    cut: Array,
    sums: Array,
    root: Floats,
) -> None:
    """Add a frame to the sums (n, 6) of vertices (n, 3): of all frames weight, of those in front weight, w d,
    w d^2 and number, of those behind weight.

    normals (n, 3); depth, weight, cosine (h, w); pose (4, 4) into the camera; camera: focal length and centre
    in the crop [px]; cut: in front, behind, width of the ramp [m]; root (n,): sum of the roots of weights.
    """
    h, w = depth.shape
    f, cx, cy = camera
    for i in range(len(vertices)):
        a, b, c = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        x = pose[0, 0] * a + pose[0, 1] * b + pose[0, 2] * c + pose[0, 3]
        y = pose[1, 0] * a + pose[1, 1] * b + pose[1, 2] * c + pose[1, 3]
        z = pose[2, 0] * a + pose[2, 1] * b + pose[2, 2] * c + pose[2, 3]
        if z <= 0.0:
            continue
        u, v = np.floor(f * x / z + cx), np.floor(f * y / z + cy)
        if not (u >= 0.0 and u < w and v >= 0.0 and v < h):
            continue
        row, column = int(v), int(u)
        full = weight[row, column]
        if full <= 0.0:
            continue
        distance = (depth[row, column] - z) * cosine[row, column]
        if distance <= -cut[1] or distance >= cut[0]:
            continue
        part = full * min((distance + cut[1]) / cut[2], 1.0)
        a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
        along = x * (pose[0, 0] * a + pose[0, 1] * b + pose[0, 2] * c)
        along += y * (pose[1, 0] * a + pose[1, 1] * b + pose[1, 2] * c)
        along += z * (pose[2, 0] * a + pose[2, 1] * b + pose[2, 2] * c)
        facing = -along / np.sqrt(x * x + y * y + z * z)
        sums[i, 0] += part
        root[i] += np.float32(np.sqrt(part))
        # a frame faces a vertex when the cosine between the ray to the camera and the normal is larger
        if facing > 0.1:
            sums[i, 1] += part
            sums[i, 2] += part * distance
            sums[i, 3] += part * distance * distance
            sums[i, 4] += 1.0
        elif facing < BEHIND:
            sums[i, 5] += part
