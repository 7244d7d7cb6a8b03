"""Faces of a mesh seen as surfaces: which lie in one plane, and which look smooth together."""

import numpy as np
import trimesh

from polhode.lie import Array
from polhode.records import Ints

SMOOTH_BELOW_DEG = 40.0
SAME_PLANE_DEG = 1.0


def smooth_corner_normals(mesh: trimesh.Trimesh) -> Array:
    """Normals per corner (F, 3, 3): mean of the neighbouring faces less than 40 degrees away.

    Faces wound the wrong way count with their sign turned: real meshes mix windings.
    """
    face_normals = np.asarray(mesh.face_normals)
    neighbours = mesh.vertex_faces[mesh.faces]
    n = np.where(neighbours[..., None] >= 0, face_normals[neighbours], 0.0)
    cosine = np.einsum("fcnk,fk->fcn", n, face_normals)
    area = np.where(neighbours >= 0, mesh.area_faces[neighbours], 0.0)
    weight = np.sign(cosine) * area * (np.abs(cosine) > np.cos(np.deg2rad(SMOOTH_BELOW_DEG)))
    total = np.einsum("fcn,fcnk->fck", weight, n)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    flat = np.broadcast_to(face_normals[:, None], total.shape)
    return np.where(length > 0, total / np.where(length > 0, length, 1.0), flat)


def flat_facets(mesh: trimesh.Trimesh) -> list[Ints]:
    """Faces of the same plane, one array per plane, in order of the first face."""
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    offset = np.einsum("fk,fk->f", mesh.face_normals, mesh.triangles[:, 0]) / extent
    key = np.round(np.column_stack([mesh.face_normals, offset]), 5)
    key += 0.0
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.reshape(-1)
    order = dict.fromkeys(group.tolist())
    return [np.flatnonzero(group == g) for g in order]


def flat_regions(mesh: trimesh.Trimesh, smallest_m2: float) -> list[Ints]:
    """Faces that hang together in one plane, at least smallest_m2 [m^2] large, the largest first.

    A finely cut curved surface is no region: its faces hang together, but in no plane.
    """
    if len(mesh.faces) < 2:
        return []
    almost_flat = np.abs(mesh.face_adjacency_angles) < np.deg2rad(0.5 * SAME_PLANE_DEG)
    labels = trimesh.graph.connected_component_labels(
        mesh.face_adjacency[almost_flat], node_count=len(mesh.faces)
    )
    area = np.bincount(labels, weights=mesh.area_faces)
    regions = []
    for label in np.argsort(-area, kind="stable"):
        if area[label] < smallest_m2:
            break
        faces = np.flatnonzero(labels == label)
        normal = mesh.area_faces[faces] @ mesh.face_normals[faces]
        length = np.linalg.norm(normal)
        if length > 0 and (mesh.face_normals[faces] @ normal / length).min() > np.cos(
            np.deg2rad(SAME_PLANE_DEG)
        ):
            regions.append(faces)
    return regions
