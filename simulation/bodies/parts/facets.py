"""Faces of a mesh as surfaces: which are coplanar, and which form a smooth surface.

trimesh's own facets leave out single faces and faces that are not adjacent, and its vertex normals round off
sharp edges.
"""

import numpy as np
import trimesh

from polhode.compiled import compiled
from polhode.lie import Array
from polhode.records import Bools, Ints

SMOOTH_BELOW_DEG = 40.0
SAME_PLANE_DEG = 1.0
CURVED_BELOW_DEG = 30.0
"""Neighbouring facets of a curved wall meet at less than this."""


def smooth_corner_normals(mesh: trimesh.Trimesh) -> Array:
    """Normals per corner (F, 3, 3): mean of the neighbouring faces less than 40 degrees away.

    Faces of opposite winding count with the opposite sign: real meshes have inconsistent windings.
    """
    faces = np.ascontiguousarray(mesh.faces)
    order = np.argsort(faces.ravel(), kind="stable")
    start = np.searchsorted(faces.ravel()[order], np.arange(len(mesh.vertices) + 1))
    normals, area = np.ascontiguousarray(mesh.face_normals), np.ascontiguousarray(mesh.area_faces)
    return np.asarray(_smooth(faces, order // 3, start, normals, area))


@compiled
def _smooth(faces: Ints, face_at: Ints, start: Ints, normals: Array, area: Array) -> Array:
    """``face_at[start[v] : start[v + 1]]`` are the faces around vertex v."""
    out = np.empty((len(faces), 3, 3))
    limit = np.cos(np.deg2rad(SMOOTH_BELOW_DEG))
    for f in range(len(faces)):
        for c in range(3):
            x, y, z = 0.0, 0.0, 0.0
            for at in range(start[faces[f, c]], start[faces[f, c] + 1]):
                g = face_at[at]
                cosine = (
                    normals[f, 0] * normals[g, 0]
                    + normals[f, 1] * normals[g, 1]
                    + normals[f, 2] * normals[g, 2]
                )
                if abs(cosine) > limit:
                    weight = area[g] if cosine > 0.0 else -area[g]
                    x += weight * normals[g, 0]
                    y += weight * normals[g, 1]
                    z += weight * normals[g, 2]
            length = np.sqrt(x * x + y * y + z * z)
            if length > 0.0:
                out[f, c, 0], out[f, c, 1], out[f, c, 2] = x / length, y / length, z / length
            else:
                out[f, c] = normals[f]
    return out


def flat_facets(mesh: trimesh.Trimesh) -> list[Ints]:
    """Coplanar faces, one array per plane, in order of the first face."""
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    offset = np.einsum("fk,fk->f", mesh.face_normals, mesh.triangles[:, 0]) / extent
    key = np.round(np.column_stack([mesh.face_normals, offset]), 5)
    key += 0.0
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.reshape(-1)
    order = dict.fromkeys(group.tolist())
    return [np.flatnonzero(group == g) for g in order]


def flat_regions(mesh: trimesh.Trimesh, smallest_m2: float) -> list[Ints]:
    """Flat sides: connected coplanar faces of at least smallest_m2 [m^2], the largest first.

    Facets of a curved wall are left out: more than half of their boundary is a smooth transition to the next.
    """
    if len(mesh.faces) < 2:
        return []
    angle = np.abs(mesh.face_adjacency_angles)
    same = angle < np.deg2rad(0.5 * SAME_PLANE_DEG)
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency[same], node_count=len(mesh.faces))
    area = np.bincount(labels, weights=mesh.area_faces)
    rim, soft = _rims(mesh, labels, same, angle < np.deg2rad(CURVED_BELOW_DEG))
    regions = []
    for label in np.argsort(-area, kind="stable"):
        if area[label] < smallest_m2:
            break
        faces = np.flatnonzero(labels == label)
        normal = mesh.area_faces[faces] @ mesh.face_normals[faces]
        length = np.linalg.norm(normal)
        flat = length > 0 and (mesh.face_normals[faces] @ normal).min() > length * np.cos(
            np.deg2rad(SAME_PLANE_DEG)
        )
        if flat and soft[label] <= 0.5 * rim[label]:
            regions.append(faces)
    return regions


def _rims(mesh: trimesh.Trimesh, labels: Ints, same: Bools, smooth: Bools) -> tuple[Array, Array]:
    """Length of each region's boundary, and of the part of it that is a smooth transition to another
    region.
    """
    a, b, c = (mesh.triangles[:, k] for k in range(3))
    around = np.linalg.norm(b - a, axis=1) + np.linalg.norm(c - b, axis=1) + np.linalg.norm(a - c, axis=1)
    rim = np.bincount(labels, weights=around)
    ends = mesh.vertices[mesh.face_adjacency_edges]
    edge = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    one, other = labels[mesh.face_adjacency.T]
    count = len(rim)
    inner = np.bincount(one[same], weights=2.0 * edge[same], minlength=count)
    bent = smooth & ~same
    soft = np.bincount(np.r_[one[bent], other[bent]], weights=np.r_[edge[bent], edge[bent]], minlength=count)
    return np.asarray(rim - inner, np.float64), np.asarray(soft, np.float64)
