"""Orientation of a mesh's faces: neighbours agree, normals point outward; and whether a point is inside.

Across an edge that exactly two faces share, both have the same orientation if they run along it in opposite
directions. So the faces connected by such edges, a patch, have two orientations, or none if the patch is
one-sided (a Moebius strip). Which of the two is the outward one is decided by the visibility of its sides:
more light reaches a body's outside (Takayama et al., "A simple method for correcting facet orientations in
polygon meshes based on ray casting", J. Computer Graphics Techniques 3, 2014). This needs no closed surface.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from polhode.geometry.lie import Array, Bools, Ints

DIRECTIONS = 24

Shaded = Callable[[Array, Array, float], Bools]
"""Whether the mesh blocks the light of direction (3,) to points (m, 3), beyond a clearance [m]"""


@dataclass(frozen=True)
class MeshEdges:
    """The m edges of a mesh."""

    vertices: Ints
    """(m, 2) ascending"""
    first: Ints
    """(m,) one of the edge's faces"""
    second: Ints
    """(m,) another one; the same at a rim"""
    count: Ints
    """(m,) number of faces"""
    agree: Bools
    """(m,) whether first and second run along the edge in opposite directions"""


def mesh_edges(surface: trimesh.Trimesh) -> MeshEdges:
    """The edges, by their vertices."""
    edges, face = np.asarray(surface.edges), np.asarray(surface.edges_face)
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, start, of_edge, count = np.unique(
        low * len(surface.vertices) + high, return_index=True, return_inverse=True, return_counts=True
    )
    order = np.argsort(of_edge.reshape(-1), kind="stable")
    at = np.cumsum(count) - count
    one, other = order[at], order[at + np.minimum(count, 2) - 1]
    return MeshEdges(
        np.column_stack([low[start], high[start]]),
        face[one],
        face[other],
        count,
        np.asarray(edges[one, 0] != edges[other, 0]),
    )


@dataclass(frozen=True)
class Orientation:
    """How the f faces of a mesh have to be turned."""

    reverse: Bools
    """(f,) whether a face's vertices are to be reversed"""
    one_sided: Bools
    """(f,) faces of one-sided patches, which no reversal makes consistent"""
    closed: Bools
    """(f,) faces of patches without a rim: they enclose a volume"""


def outward_orientation(surface: trimesh.Trimesh, shaded: Shaded) -> Orientation:
    """Consistent faces with normals outward, where sides of the surface are unequally visible."""
    count, area = len(surface.faces), np.asarray(surface.area_faces)
    edges = mesh_edges(surface)
    # A graph in which each face occurs twice, as given and reversed: the components of a patch are two mirror
    # images, or one where the patch is one-sided.
    pair = edges.count == 2
    a, b, agree = edges.first[pair], edges.second[pair], edges.agree[pair]
    rows = np.concatenate([a, a + count])
    columns = np.concatenate([np.where(agree, b, b + count), np.where(agree, b + count, b)])
    graph = coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    given_label, turned_label = connected_components(graph, directed=False)[1].reshape(2, count)
    patch = np.unique(np.minimum(given_label, turned_label), return_inverse=True)[1].reshape(-1)
    same_as_first, one_sided = given_label <= turned_label, given_label == turned_label

    sense = np.where(same_as_first, 1.0, -1.0)
    given, total = np.bincount(patch, area * sense), np.bincount(patch, area)
    consistent = np.abs(given) > (1.0 - 1e-9) * total
    front, back = _visibility(surface, patch, shaded)
    # of the orientation in which faces with a sense of 1 remain as they are
    ahead, behind = np.bincount(patch, sense * (front - back)), np.bincount(patch, front + back)
    forward, backward = 0.5 * (behind + ahead), 0.5 * (behind - ahead)
    # what is given counts where the sides are equally visible, and more where all faces agree
    # (a hemisphere, where it is 2, remains as it is if it is modelled by its inside)
    factor = np.where(consistent, 2.5, 1.02)
    keep = np.where(given >= 0.0, backward <= factor * forward + 1e-9, forward > factor * backward + 1e-9)
    reverse = (same_as_first != keep[patch]) & ~one_sided
    rim = np.zeros(count, dtype=bool)
    rim[edges.first[edges.count == 1]] = True
    closed = np.bincount(patch, rim) == 0
    return Orientation(np.asarray(reverse), one_sided, np.asarray(closed[patch] & ~one_sided))


def _visibility(surface: trimesh.Trimesh, patch: Ints, shaded: Shaded) -> tuple[Array, Array]:
    """(f,) light of the whole sky that reaches front and back of sampled faces, times their areas."""
    order = np.argsort(patch, kind="stable")
    size = np.bincount(patch)
    number = np.arange(len(patch)) - np.repeat(np.cumsum(size) - size, size)
    # up to 32 faces of each patch
    chosen = order[number % (-(-size // 32))[patch[order]] == 0]
    centre, normal = np.asarray(surface.triangles_center)[chosen], np.asarray(surface.face_normals)[chosen]
    clearance_m = 1e-5 * float(np.linalg.norm(np.ptp(surface.bounds, axis=0)))
    both = np.zeros((2, len(patch)))
    # directions along a spiral of the golden angle
    k = np.arange(DIRECTIONS) + 0.5
    z, around = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (3.0 - np.sqrt(5.0)) * k
    for direction in np.column_stack(
        [np.sqrt(1 - z**2) * np.cos(around), np.sqrt(1 - z**2) * np.sin(around), z]
    ):
        cosine = np.where(shaded(direction, centre, clearance_m), 0.0, normal @ direction)
        both[:, chosen] += np.maximum([cosine, -cosine], 0.0)
    front, back = both * np.asarray(surface.area_faces)
    return front, back


def winding_number(triangles: Array, p: Array) -> float:
    """Solid angle of triangles (f, 3, 3) around p (3,), over 4 pi: 1 inside a closed surface, 0 outside.

    Van Oosterom and Strackee, IEEE Trans. Biomedical Engineering 30, 1983. Jacobson et al., SIGGRAPH 2013,
    use it as a measure of inside for surfaces with holes.
    """
    a, b, c = np.swapaxes(np.asarray(triangles) - p, 0, 1)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("fk,fk->f", a, np.cross(b, c))
    dot = [np.einsum("fk,fk->f", u, v) for u, v in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb
    return float(np.arctan2(volume, below).sum() / (2.0 * np.pi))
