"""Views of a mesh by a camera that turns around it, rendered by rays with a Lambert law of our own."""

from collections.abc import Callable

import numpy as np
import trimesh

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.mapping.visibility import Caster, FrameView

RIG = RectifiedRig(240.0, 79.5, 59.5, 0.09, 160, 120)
DISTANCE_M = 0.5

Albedo = Callable[[Array], Array]
"""Points in G (n, 3) -> grey (n,) of the surface facing the Sun"""


def tumbling(frames: int) -> list[Array]:
    """X_RG of a body that turns about an axis which wanders."""
    turn = [exp_so3([0.5 * np.sin(0.4 * k), 0.35 * k, 0.2 * k]) for k in range(frames)]
    return [make_pose(R, np.array([0.0, 0.0, DISTANCE_M])) for R in turn]


def rendered(
    mesh: trimesh.Trimesh, X_RG: Array, sun_N: Array, albedo: Albedo, ambient: float = 0.0
) -> FrameView:
    """One frame; N is the camera. Shadows that the body throws on itself are cast."""
    caster = Caster(mesh)
    v, u = np.mgrid[: RIG.height_px, : RIG.width_px]
    ray = np.stack([(u - RIG.cx_px) / RIG.focal_px, (v - RIG.cy_px) / RIG.focal_px, np.ones(u.shape)], -1)
    ray = ray.reshape(-1, 3) / np.linalg.norm(ray.reshape(-1, 3), axis=1, keepdims=True)
    X_GR = inverse_pose(X_RG)
    direction = ray @ X_GR[:3, :3].T
    distance, face = caster.first(X_GR[:3, 3], direction)
    hit = face >= 0
    p_G = X_GR[:3, 3] + direction[hit] * distance[hit, None]
    corner = np.asarray(mesh.triangles)[face[hit]]
    share = trimesh.triangles.points_to_barycentric(corner, p_G)
    normal = np.einsum(
        "nk,nkc->nc", share, np.asarray(mesh.vertex_normals)[np.asarray(mesh.faces)[face[hit]]]
    )
    sun_G = X_GR[:3, :3] @ sun_N
    light = np.maximum(normal @ sun_G, 0.0) * caster.lit_by(sun_G, p_G) + ambient
    image = np.zeros(RIG.height_px * RIG.width_px)
    image[hit] = albedo(p_G) * light
    shape = (RIG.height_px, RIG.width_px)
    grey = np.clip(np.round(image), 0, 255).astype(np.uint8)
    return FrameView(grey.reshape(shape), hit.reshape(shape), X_RG, np.eye(3))
