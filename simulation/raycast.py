"""Ray casting against a body in G with embree."""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from polhode.lie import Array
from polhode.records import Bools, Ints
from simulation.bodies import Body


@dataclass(frozen=True)
class Hits:
    """Where n rays of many met the body."""

    ray: Ints
    """(n,) index of the ray"""
    face: Ints
    """(n,)"""
    weights: Array
    """(n, 3) of the face's corners; they add up to 1"""
    distance_m: Array
    """(n,) along the ray"""
    p_G: Array
    """(n, 3) [m]"""
    flat_normal_G: Array
    """(n, 3) of the face, turned to the viewer"""
    normal_G: Array
    """(n, 3) interpolated, turned to the viewer"""


class RayCaster:
    """The body in embree's hierarchy. Distances reach 1e-7 of the distance to the camera."""

    def __init__(self, body: Body) -> None:
        self._triangles = np.asarray(body.mesh.triangles)
        self._face_normals = np.asarray(body.mesh.face_normals)
        self._corner_normals = body.corner_normals
        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, self._triangles.astype(np.float32))
        self._lift_m = 2e-5 * body.radius_m

    def first_hits(self, origin_G: Array, directions_G: Array) -> Hits:
        """Nearest hit of rays from one point (3,) along unit directions (n, 3)."""
        answer = self._scene.run(
            _floats(np.broadcast_to(origin_G, directions_G.shape)), _floats(directions_G), output=True
        )
        ray = np.flatnonzero(answer["primID"] >= 0)
        face = answer["primID"][ray].astype(np.int64)
        d = directions_G[ray]
        distance = self._exact_distance(origin_G, d, face, answer["tfar"][ray].astype(np.float64))
        u, v = (answer[name][ray, None].astype(np.float64) for name in ("u", "v"))
        corners = self._corner_normals[face]
        weights = np.hstack([1 - u - v, u, v])
        normal = np.einsum("nc,nck->nk", weights, corners)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        flat = self._face_normals[face]
        away = np.einsum("nk,nk->n", flat, d) > 0
        turn = np.where(away, -1.0, 1.0)[:, None]
        p_G = origin_G + distance[:, None] * d
        return Hits(ray, face, weights, distance, p_G, turn * flat, turn * normal)

    def _exact_distance(self, origin_G: Array, d: Array, face: Ints, coarse_m: Array) -> Array:
        """Distance to the face's plane in double precision, where the ray is not grazing."""
        n = self._face_normals[face]
        slope = np.einsum("nk,nk->n", n, d)
        height = np.einsum("nk,nk->n", n, self._triangles[face, 0] - origin_G)
        steep = np.abs(slope) > 1e-3
        exact = np.where(steep, height / np.where(steep, slope, 1.0), coarse_m)
        # Across the face the coarse hit is good to 1e-7 of the distance; along a grazing ray it is not.
        return np.where(np.abs((exact - coarse_m) * slope) < 1e-6 * coarse_m, exact, coarse_m)

    def lit(self, hits: Hits, direction_G: Array, reach_m: Array | None = None) -> Bools:
        """True where nothing stands between a hit and the light.

        direction_G: (3,) or (n, 3) unit, towards the light; reach_m (n,) its distance, endless when absent.
        """
        directions = np.broadcast_to(direction_G, hits.p_G.shape)
        lit = np.einsum("nk,nk->n", hits.flat_normal_G, directions) > 0
        start = hits.p_G[lit] + self._lift_m * hits.flat_normal_G[lit]
        reach = np.full(len(start), 1e6) if reach_m is None else reach_m[lit]
        blocked = self._scene.run(_floats(start), _floats(directions[lit]), _floats(reach), query="OCCLUDED")
        lit[lit] = blocked < 0
        return np.asarray(lit)


def _floats(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)
