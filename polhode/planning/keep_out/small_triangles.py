"""Signed distances to a closed surface of triangles that are about as small as each other, as of a grid."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array, Ints

NEAREST_TRIANGLES = 16
"""Candidates that are looked at first"""
CHUNK = 2000
"""Points at a time that need all that may be nearest"""


class SmallTriangles:
    """The nearest triangle to a point is one of those with the nearest centres."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._corners = np.asarray(mesh.triangles, dtype=np.float64)
        self._normals = np.asarray(mesh.face_normals, dtype=np.float64)
        centres = self._corners.mean(axis=1)
        self._tree = cKDTree(centres)
        self._radius_m = float(np.linalg.norm(self._corners - centres[:, None], axis=2).max())

    def signed_distance(self, points: Array) -> tuple[Array, Array]:
        """Distance (n,) of points (n, 3), negative behind the nearest triangle, and unit vectors (n, 3)
        outwards, along which it grows.
        """
        count = min(NEAREST_TRIANGLES, len(self._corners))
        away, index = self._tree.query(points, k=np.arange(1, count + 1))
        rows = np.repeat(np.arange(len(points)), count)
        distance, outwards = self._nearest(points, rows, index.reshape(-1))
        # no other triangle can be nearer than the last centre less a triangle's radius
        unsure = np.flatnonzero(np.abs(distance) > away[:, -1] - self._radius_m)
        for part in np.array_split(unsure, max(1, len(unsure) // CHUNK)):
            reach = np.abs(distance[part]) + 1.001 * self._radius_m
            found = self._tree.query_ball_point(points[part], reach)
            rows = np.repeat(np.arange(len(part)), [len(each) for each in found])
            if len(part):
                near = np.concatenate(found).astype(np.int64)
                distance[part], outwards[part] = self._nearest(points[part], rows, near)
        return distance, outwards

    def _nearest(self, points: Array, rows: Ints, index: Ints) -> tuple[Array, Array]:
        """As ``signed_distance``, from candidates: triangles (m,) for points of the rows (m,), ascending.

        Where several are equally near, at an edge or corner, that whose plane is farthest decides.
        """
        off = points[rows] - trimesh.triangles.closest_point(self._corners[index], points[rows])
        found = np.linalg.norm(off, axis=1)
        plane = np.einsum("mi,mi->m", off, self._normals[index])
        least = np.full(len(points), np.inf)
        np.minimum.at(least, rows, found)
        alike = found <= least[rows] + 1e-9 + 1e-6 * found
        order = np.lexsort((np.where(alike, np.abs(plane), -1.0), rows))
        best = order[np.searchsorted(rows[order], np.arange(len(points)), side="right") - 1]
        side = np.where(plane[best] < 0.0, -1.0, 1.0)
        # on the surface itself the normal
        along = side[:, None] * off[best] / np.maximum(least, 1e-300)[:, None]
        outwards = np.where((least > 1e-9 * self._radius_m)[:, None], along, self._normals[index[best]])
        return side * least, outwards
