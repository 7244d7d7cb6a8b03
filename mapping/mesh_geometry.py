"""Loops over a mesh's faces: pieces, areas, neighbours, averages over neighbours."""

import numpy as np

from polhode.compiled import compiled_fused_ieee
from polhode.lie import Array
from polhode.records import Ints

MOMENTS = 9
"""Means of x, y, z and of xx, xy, xz, yy, yz, zz"""


@compiled_fused_ieee
def piece_areas(vertices: Array, faces: Ints) -> tuple[Ints, Array]:
    """The piece of each vertex (V,), told by one of its vertices, and the areas (V,) of the pieces."""
    parent = np.arange(len(vertices))
    for f in range(len(faces)):
        a, b, c = _root(parent, faces[f, 0]), _root(parent, faces[f, 1]), _root(parent, faces[f, 2])
        least = min(a, b, c)
        parent[a] = parent[b] = parent[c] = least
    area = np.zeros(len(vertices))
    for v in range(len(vertices)):
        parent[v] = _root(parent, v)
    for f in range(len(faces)):
        a, b, c = faces[f]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0],
            vertices[b, 1] - vertices[a, 1],
            vertices[b, 2] - vertices[a, 2],
        )
        wx, wy, wz = (
            vertices[c, 0] - vertices[a, 0],
            vertices[c, 1] - vertices[a, 1],
            vertices[c, 2] - vertices[a, 2],
        )
        x, y, z = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        area[parent[a]] += 0.5 * np.sqrt(x * x + y * y + z * z)
    return parent, area


@compiled_fused_ieee
def _root(parent: Ints, v: int) -> int:
    while parent[v] != v:
        parent[v] = parent[parent[v]]
        v = parent[v]
    return v


@compiled_fused_ieee
def volume_moments(vertices: Array, faces: Ints) -> Array:
    """(10,): volume, its first moments x, y, z and second moments xx, xy, xz, yy, yz, zz about the origin.

    Sums over tetrahedra from the origin to each face (Tonon 2004).
    """
    out = np.zeros(10)
    for f in range(len(faces)):
        p, q, r = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        six = (
            p[0] * (q[1] * r[2] - q[2] * r[1])
            + p[1] * (q[2] * r[0] - q[0] * r[2])
            + p[2] * (q[0] * r[1] - q[1] * r[0])
        )
        out[0] += six / 6.0
        place = 4
        for i in range(3):
            out[1 + i] += six * (p[i] + q[i] + r[i]) / 24.0
            for j in range(i, 3):
                both = (p[i] + q[i] + r[i]) * (p[j] + q[j] + r[j])
                out[place] += six * (both + p[i] * p[j] + q[i] * q[j] + r[i] * r[j]) / 120.0
                place += 1
    return out


@compiled_fused_ieee
def neighbours(faces: Ints, count: int) -> tuple[Ints, Ints]:
    """Starts (V + 1,) and the neighbours of each of ``count`` vertices, along the faces' winding.

    Each edge between two faces is walked both ways, one at a rim once: a rim's vertex lacks one neighbour.
    """
    start = np.zeros(count + 1, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            start[faces[f, k] + 1] += 1
    for v in range(count):
        start[v + 1] += start[v]
    at, other = start[:-1].copy(), np.empty(3 * len(faces), np.int64)
    for f in range(len(faces)):
        for k in range(3):
            v = faces[f, k]
            other[at[v]] = faces[f, (k + 1) % 3]
            at[v] += 1
    return start, other


@compiled_fused_ieee
def rim_edges(faces: Ints, start: Ints, other: Ints) -> Ints:
    """Edges (n, 2) with one face, as that face winds them, in the order of the faces; see ``neighbours``."""
    out, count = np.empty((3 * len(faces), 2), np.int64), 0
    for f in range(len(faces)):
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            walked = 0
            for n in range(start[a], start[a + 1]):
                walked += other[n] == b
            for n in range(start[b], start[b + 1]):
                walked += other[n] == a
            if walked == 1:
                out[count, 0], out[count, 1] = a, b
                count += 1
    return out[:count].copy()


@compiled_fused_ieee
def averaged(values: Array, start: Ints, other: Ints) -> Array:
    """Values (V, 9) averaged over each vertex and its neighbours."""
    out = np.empty_like(values)
    for v in range(len(values)):
        # nine sums at once: their number must be known when this is compiled
        for k in range(MOMENTS):
            out[v, k] = values[v, k]
        for n in range(start[v], start[v + 1]):
            w = np.uint64(other[n])
            for k in range(MOMENTS):
                out[v, k] += values[w, k]
        share = 1.0 / (1 + start[v + 1] - start[v])
        for k in range(MOMENTS):
            out[v, k] *= share
    return out


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
