"""Ray casting against a body in G with embree."""

from dataclasses import dataclass, fields

import numpy as np

from polhode.geometry.lie import Array, Bools, Ints
from polhode.geometry.rays import RayScene
from polhode.simulation.bodies import Body


@dataclass(frozen=True)
class Hits:
    """Hits of n rays, out of many, on the body."""

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

    def __getitem__(self, which: Ints | Bools) -> "Hits":
        return Hits(*(getattr(self, field.name)[which] for field in fields(self)))


class RayCaster:
    """The body in embree's bounding volume hierarchy; distances are accurate to 1e-7 of their length."""

    def __init__(self, body: Body) -> None:
        self._triangles = np.asarray(body.mesh.triangles)
        self._face_normals = np.asarray(body.mesh.face_normals)
        self._corner_normals = body.corner_normals
        self._scene = RayScene(self._triangles)
        self._lift_m = 2e-5 * body.radius_m

    def first_hits(self, origin_G: Array, directions_G: Array) -> Hits:
        """Nearest hit of rays along unit directions (n, 3), from one point (3,) or a point each (n, 3)."""
        origins = np.broadcast_to(origin_G, directions_G.shape)
        met = self._scene.first_hits(origins, directions_G)
        ray = np.flatnonzero(met.face >= 0)
        face, d, origin = met.face[ray], directions_G[ray], origins[ray]
        distance = self._exact_distance(origin, d, face, met.distance[ray])
        u, v = met.u[ray, None], met.v[ray, None]
        weights = np.hstack([1 - u - v, u, v])
        return self._hits(ray, face, weights, distance, origin + distance[:, None] * d, d)

    def hits_at(self, face: Ints, weights: Array, seen_from_G: Array) -> Hits:
        """Hits at points of faces (n,), given weights (n, 3) of the corners, seen from directions (n, 3)."""
        p_G = np.einsum("nc,nck->nk", weights, self._triangles[face])
        n = len(face)
        return self._hits(np.arange(n), face, weights, np.zeros(n), p_G, -seen_from_G)

    def _hits(self, ray: Ints, face: Ints, weights: Array, distance_m: Array, p_G: Array, d: Array) -> Hits:
        normal = np.einsum("nc,nck->nk", weights, self._corner_normals[face])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        flat = self._face_normals[face]
        turn = np.where(np.einsum("nk,nk->n", flat, d) > 0, -1.0, 1.0)[:, None]
        return Hits(ray, face, weights, distance_m, p_G, turn * flat, turn * normal)

    def _exact_distance(self, origin: Array, d: Array, face: Ints, coarse_m: Array) -> Array:
        """Distance to the face's plane in double precision, where the ray is not grazing."""
        n = self._face_normals[face]
        slope = np.einsum("nk,nk->n", n, d)
        height = np.einsum("nk,nk->n", n, self._triangles[face, 0] - origin)
        steep = np.abs(slope) > 1e-3
        exact = np.where(steep, height / np.where(steep, slope, 1.0), coarse_m)
        # Across the face the coarse hit is good to 1e-7 of the distance; along a grazing ray it is not.
        return np.where(np.abs((exact - coarse_m) * slope) < 1e-6 * coarse_m, exact, coarse_m)

    def lit(self, hits: Hits, direction_G: Array, reach_m: Array | None = None) -> Bools:
        """True where nothing blocks the light at a hit.

        direction_G: (3,) or (n, 3) unit, towards the light; reach_m (n,) its distance, infinite if absent.
        The interpolated normal decides which side of the terminator a hit is on.
        """
        directions = np.broadcast_to(direction_G, hits.p_G.shape)
        lit = np.einsum("nk,nk->n", hits.normal_G, directions) > 0
        start = hits.p_G[lit] + self._lift_m * hits.flat_normal_G[lit]
        # Facets of a curved part that face away from the light before the curved surface itself does.
        early = np.einsum("nk,nk->n", hits.flat_normal_G[lit], directions[lit]) <= 0
        start[early] += self._bulge(hits, np.flatnonzero(lit)[early])
        reach = np.full(len(start), 1e6) if reach_m is None else reach_m[lit]
        lit[lit] = ~self._scene.blocked(start, directions[lit], reach)
        return np.asarray(lit)

    def clear(self, hits: Hits, directions_G: Array, reach_m: Array) -> Bools:
        """True where nothing, including the hit's own flat face, blocks the directions (n, 3)."""
        clear = np.einsum("nk,nk->n", hits.flat_normal_G, directions_G) > 0
        start = hits.p_G[clear] + self._lift_m * hits.flat_normal_G[clear]
        clear[clear] = ~self._scene.blocked(start, directions_G[clear], reach_m[clear])
        return np.asarray(clear)

    def next_hits(self, hits: Hits, directions_G: Array) -> Hits:
        """Next hits of rays that leave n hits along unit directions (n, 3); ``ray`` indexes the hits."""
        return self.first_hits(hits.p_G + self._lift_m * hits.flat_normal_G, directions_G)

    def meets(self, p_G: Array, normal_G: Array, directions_G: Array) -> tuple[Ints, Array]:
        """Faces hit by rays that leave the surface at p_G (n, 3), on the side of normal_G (n, 3).

        Returns face (n,), -1: none, and the distance (n,) [m], both in single precision.
        """
        met = self._scene.first_hits(p_G + self._lift_m * normal_G, directions_G)
        return met.face, met.distance

    def _bulge(self, hits: Hits, which: Ints) -> Array:
        """Offset (m, 3) from hits (m,) to the curved surface that the flat faces approximate [m].

        Hanika, "Hacking the shadow terminator", Ray Tracing Gems II, 2021.
        """
        face = hits.face[which]
        normals = self._corner_normals[face]
        side = np.sign(np.einsum("nck,nk->nc", normals, hits.normal_G[which]))[..., None] * normals
        height = np.einsum("nck,nck->nc", self._triangles[face] - hits.p_G[which, None], side)
        return np.asarray(np.einsum("nc,nc,nck->nk", hits.weights[which], np.maximum(height, 0.0), side))
