"""The mesh for a viewer, and which of its faces the frames up to each one have seen."""

from collections.abc import Iterator

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, inverse_pose, transform_points
from polhode.mapping.visibility import Caster
from polhode.records.surface import SurfaceModel
from polhode.report.shape_figures import thin_mesh, vertex_rgb

MAX_STEPS = 20
"""Times at which the shown mesh grows: each of them holds all faces up to then."""
MAX_FRAMES = 300
"""Frames, evenly spread, in which visibility is computed."""


def coloured_mesh(surface: SurfaceModel, max_faces: int) -> tuple[Array, NDArray[np.uint8], Ints]:
    """Vertices (V, 3) [m], colours (V, 3) and faces (T, 3) of a surface, thinned where it has more."""
    vertices, faces, of_old = thin_mesh(surface.mesh, max_faces)
    return vertices, vertex_rgb(surface.mesh)[of_old], faces


def growth(mesh: trimesh.Trimesh, X_RG: Array, rig: RectifiedRig) -> Iterator[tuple[int, Ints]]:
    """Frames at which the mesh grows, and all faces (T, 3) that were seen up to then.

    A face is seen in the first frame up to which each of its vertices was in the left image with nothing
    before it. X_RG (F, 4, 4). The last frame has the whole mesh: what no frame has seen, too.
    """
    n_frames, faces = len(X_RG), np.asarray(mesh.faces, dtype=np.int64)
    first = first_seen(mesh, X_RG, rig)[faces].max(axis=1) if len(faces) else np.zeros(0, dtype=np.int64)
    shown = 0
    for k in range(n_frames):
        seen = first <= k if k < n_frames - 1 else np.ones(len(faces), dtype=np.bool_)
        count = int(seen.sum())
        if k == 0 or (count > shown and (k == n_frames - 1 or count - shown >= len(faces) / MAX_STEPS)):
            yield k, faces[seen]
            shown = count


def first_seen(mesh: trimesh.Trimesh, X_RG: Array, rig: RectifiedRig) -> Ints:
    """(V,) the first frame that sees each vertex; F, the number of frames, where none does."""
    vertices, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    first = np.full(len(vertices), len(X_RG), dtype=np.int64)
    caster = Caster(mesh)
    for k in np.unique(np.linspace(0, len(X_RG) - 1, MAX_FRAMES).round().astype(int)).tolist():
        unseen = np.flatnonzero(first == len(X_RG))
        p_R = transform_points(X_RG[k], vertices[unseen])
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v, _ = rig.project(p_R).T
        inside = (u >= 0) & (u <= rig.width_px - 1) & (v >= 0) & (v <= rig.height_px - 1)
        unseen = unseen[inside & (p_R[:, 2] > 0.0)]
        eye_G = inverse_pose(X_RG[k])[:3, 3]
        first[unseen[caster.sees(eye_G, vertices[unseen], normals[unseen])]] = k
    return first
