"""What a body hides: rays in embree, in single precision around the body's middle."""

import numpy as np
import trimesh

from polhode.lie import Array
from polhode.rays import RayScene
from polhode.records import Bools


class Occluder:
    """A mesh in G that stands in the way of rays."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        bounds = np.asarray(mesh.bounds)
        self._middle = bounds.mean(axis=0)
        self._radius_m = 0.5 * float(np.linalg.norm(bounds[1] - bounds[0]))
        self._scene = RayScene(np.asarray(mesh.triangles) - self._middle)

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
        return self._scene.blocked(start, direction, np.maximum(distance - skip - clearance_m, 0.0))

    def shades(self, towards_G: Array, p_G: Array, clearance_m: float) -> Bools:
        """(m,) true where the body stands between points (m, 3) and a light far away, towards (3,)."""
        if len(p_G) == 0:
            return np.zeros(0, dtype=bool)
        direction = np.broadcast_to(towards_G / np.linalg.norm(towards_G), p_G.shape)
        reach = np.full(len(p_G), 4.0 * self._radius_m)
        return self._scene.blocked(p_G - self._middle + clearance_m * direction, direction, reach)
