"""Signed distances to a closed surface of triangles that are about as small as each other, as of a grid."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array

NEAREST_TRIANGLES = (16, 128)
"""Candidates, more for points that have not found the nearest one"""


class SmallTriangles:
    """The nearest triangle to a point is one of those with the nearest centres."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._corners = np.asarray(mesh.triangles, dtype=np.float64)
        self._normals = np.asarray(mesh.face_normals, dtype=np.float64)
        centres = self._corners.mean(axis=1)
        self._tree = cKDTree(centres)
        self._radius_m = float(np.linalg.norm(self._corners - centres[:, None], axis=2).max())

    def signed_distance(self, points: Array) -> tuple[Array, Array]:
        """Lower and upper bound (n,) of the distance of points (n, 3), negative behind the nearest triangle.

        They agree but for far points, by less than a triangle.
        """
        low, high = np.empty(len(points)), np.empty(len(points))
        unsure = np.arange(len(points))
        for count in NEAREST_TRIANGLES:
            low[unsure], high[unsure] = self._bounds(points[unsure], min(count, len(self._corners)))
            unsure = unsure[low[unsure] < high[unsure]]
        return low, high

    def _bounds(self, points: Array, count: int) -> tuple[Array, Array]:
        """As ``signed_distance``, from so many candidates.

        Where several are equally near, at an edge or corner, that whose plane is farthest decides.
        """
        away, index = self._tree.query(points, k=np.arange(1, count + 1))
        best, side = np.full(len(points), np.inf), np.zeros(len(points))
        for n in range(count):
            off = points - trimesh.triangles.closest_point(self._corners[index[:, n]], points)
            found = np.linalg.norm(off, axis=1)
            plane = np.einsum("ni,ni->n", off, self._normals[index[:, n]])
            alike = np.abs(found - best) <= 1e-9 + 1e-6 * found
            better = (found < best) & ~alike | alike & (np.abs(plane) > np.abs(side))
            side, best = np.where(better, plane, side), np.minimum(best, found)
        # no other triangle can be nearer than the last centre less a triangle's radius
        rest = np.inf if count == len(self._corners) else away[:, -1] - self._radius_m
        least = np.clip(rest, 0.0, best)
        return np.where(side < 0.0, -best, least), np.where(side < 0.0, -least, best)
