"""Occlusion by a body: ray casting with Embree, in single precision about the body's centre."""

import numpy as np
import trimesh

from polhode.lie import Array
from polhode.rays import RayScene
from polhode.records import Bools


class Occluder:
    """A mesh in G that blocks rays."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        bounds = np.asarray(mesh.bounds)
        self._middle = bounds.mean(axis=0)
        self._radius_m = 0.5 * float(np.linalg.norm(bounds[1] - bounds[0]))
        self._scene = RayScene(np.asarray(mesh.triangles) - self._middle)

    def hides(self, eye_G: Array, p_G: Array, clearance_m: float) -> Bools:
        """(m,) true where the body blocks the ray from the eye (3,) to points (m, 3), less the clearance."""
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
        """(m,) true where the body blocks the light of a distant source towards (3,) from points (m, 3)."""
        if len(p_G) == 0:
            return np.zeros(0, dtype=bool)
        direction = np.broadcast_to(towards_G / np.linalg.norm(towards_G), p_G.shape)
        range_m = np.full(len(p_G), 4.0 * self._radius_m)
        return self._scene.blocked(p_G - self._middle + clearance_m * direction, direction, range_m)
