"""Pieces of a mesh, its border, sums over neighbouring vertices, spread of points about a plane."""

import numpy as np
import trimesh
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled_fused_ieee


def piece_areas(vertices: Array, faces: Ints) -> tuple[Ints, Array]:
    """The connected piece of each vertex (V,), and the areas (pieces,) of the pieces."""
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2).T
    joined = coo_array((np.ones(ends.shape[1], np.int8), ends), shape=(len(vertices), len(vertices)))
    count, piece = connected_components(joined, directed=False)
    area = trimesh.triangles.area(vertices[faces])
    return piece, np.asarray(np.bincount(piece[faces[:, 0]], weights=area, minlength=count), np.float64)


def boundary_edges(faces: Ints) -> Ints:
    """Edges (n, 2) with one face, as that face winds them, in the order of the faces."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    once = trimesh.grouping.group_rows(np.sort(edges, axis=1), require_count=1)
    return np.asarray(edges[np.sort(once)], dtype=np.int64)


def border_vertices(faces: Ints, count: int) -> Ints:
    """Vertices of edges with one face, of a mesh with ``count`` vertices whose faces are wound alike.

    Around an inner vertex each neighbour follows it in one face and precedes it in another, so the numbers of
    those that follow and of those that precede have the same sum.
    """
    out = np.zeros(count)
    for corner in range(3):
        after, before = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        out += np.bincount(faces[:, corner], weights=after - before, minlength=count)
    return np.flatnonzero(out)


def neighbour_sums(faces: Ints, count: int) -> csr_array:
    """(V, V) with ones: multiplied by values, it adds to that of each vertex those of its neighbours.

    Neighbours are taken along the faces' winding: a vertex of a boundary lacks one.
    """
    row = np.concatenate([np.arange(count), faces.reshape(-1)])
    column = np.concatenate([np.arange(count), np.roll(faces, -1, axis=1).reshape(-1)])
    start = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=count))])
    return csr_array((np.ones(len(row)), column[np.argsort(row, kind="stable")], start), shape=(count, count))


@compiled_fused_ieee
def min_spread(moments: Array) -> Array:
    """Smallest eigenvalue (V,) of second moments about the mean, not negative.

    The roots of a symmetric matrix's characteristic polynomial are cosines (Smith 1961).
    """
    out = np.empty(len(moments))
    for v in range(len(moments)):
        x, y, z, xx, xy, xz, yy, yz, zz = moments[v]
        a, b, c, d, e, f = xx - x * x, yy - y * y, zz - z * z, xy - x * y, xz - x * z, yz - y * z
        mean = (a + b + c) / 3.0
        a, b, c = a - mean, b - mean, c - mean
        p = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
        if p <= 0.0:
            out[v] = max(mean, 0.0)
            continue
        half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / (2.0 * p * p * p)
        angle = np.arccos(min(max(half, -1.0), 1.0)) / 3.0
        out[v] = max(mean + 2.0 * p * np.cos(angle + 2.0 * np.pi / 3.0), 0.0)
    return out
