"""What a body hides: rays in embree, in single precision around the body's middle."""

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from polhode.lie import Array
from polhode.records import Bools


class Occluder:
    """A mesh in G that stands in the way of rays."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        bounds = np.asarray(mesh.bounds)
        self._middle = bounds.mean(axis=0)
        self._radius_m = 0.5 * float(np.linalg.norm(bounds[1] - bounds[0]))
        self._scene = EmbreeScene(robust=True)
        triangles = (np.asarray(mesh.triangles) - self._middle).astype(np.float32)
        TriangleMesh(self._scene, np.ascontiguousarray(triangles))

    def hides(self, eye_G: Array, p_G: Array, clearance_m: float) -> Bools:
        """(m,) true where the body stands between the eye (3,) and points (m, 3), short of the clearance."""
        if len(p_G) == 0:
            return np.zeros(0, dtype=bool)
        ray = p_G - eye_G
        distance = np.linalg.norm(ray, axis=1)
        direction = ray / np.maximum(distance, 1e-12)[:, None]
        # Start near the body: single precision is then enough at any range.
        skip = np.maximum(distance - 2.5 * self._radius_m, 0.0)
        start = eye_G + skip[:, None] * direction - self._middle
        return self._blocked(start, direction, distance - skip - clearance_m)

    def shades(self, towards_G: Array, p_G: Array, clearance_m: float) -> Bools:
        """(m,) true where the body stands between points (m, 3) and a light far away, towards (3,)."""
        if len(p_G) == 0:
            return np.zeros(0, dtype=bool)
        direction = np.broadcast_to(towards_G / np.linalg.norm(towards_G), p_G.shape)
        reach = np.full(len(p_G), 4.0 * self._radius_m)
        return self._blocked(p_G - self._middle + clearance_m * direction, direction, reach)

    def _blocked(self, start: Array, direction: Array, reach_m: Array) -> Bools:
        found = self._scene.run(
            np.ascontiguousarray(start, dtype=np.float32),
            np.ascontiguousarray(direction, dtype=np.float32),
            np.ascontiguousarray(np.maximum(reach_m, 0.0), dtype=np.float32),
            query="OCCLUDED",
        )
        return np.asarray(found >= 0)
