"""Probes spread over the body's surface, and what each of them sees in every direction.

They are built once per body. The light of a frame then comes from table look-ups, free of noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from polhode.compiled import compiled
from polhode.lie import Array
from polhode.records import Bools, Ints
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.rendering.sampling import even_directions
from polhode.simulation.rendering.surface_interpolation import SurfaceInterpolation

SKY, BELOW, DARK = -1, -2, -3
"""Entries of the table apart from probes: open sky; below the probe's own horizon; an unlit surface."""
PROBES = 5000
POINTS_A_PROBE = 6
"""Points on the whole surface, inside and out, for each probe on the surface that light reaches."""
DIRECTIONS = 1024
PILOT_DIRECTIONS = 64
RAYS_AT_ONCE = 1 << 18
LOWEST = 1e-3
"""Directions with a smaller sine of the elevation are ignored."""
PACKING = 0.6
"""Number of probes on a square with their spacing as side."""
NORMAL_FACTOR = 1.0
"""A difference of one radian between normals separates probes like this many spacings."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points of the body's surface, of equal share in its area."""

    face: Ints
    """(n,)"""
    weights: Array
    """(n, 3) of the face's corners"""
    p_G: Array
    """(n, 3) [m]"""
    normal_G: Array
    """(n, 3) unit, of the face, on the side that light can reach"""

    def __getitem__(self, which: Ints | Bools) -> "SurfacePoints":
        return SurfacePoints(self.face[which], self.weights[which], self.p_G[which], self.normal_G[which])


@dataclass(frozen=True)
class Probes:
    """P probes, D directions."""

    points: SurfacePoints
    """(M,) points on the surface, for means around the probes"""
    owner: Ints
    """(M,) the probe that a point belongs to"""
    p_G: Array
    """(P, 3) [m]"""
    normal_G: Array
    """(P, 3)"""
    directions_G: Array
    """(D, 3) unit, evenly over the sphere, the same for all probes"""
    sees: NDArray[np.int16]
    """(P, D) the probe that is seen, or SKY, BELOW, DARK"""
    around: SurfaceInterpolation

    def mean(self, of_points: Array) -> Array:
        """Mean (P,) around each probe of a quantity (M,)."""
        count = len(self.p_G)
        total = np.bincount(self.owner, weights=of_points, minlength=count)
        return np.asarray(total / np.maximum(np.bincount(self.owner, minlength=count), 1))


def place_probes(mesh: trimesh.Trimesh, caster: RayCaster, count: int = PROBES) -> Probes:
    """Spread about ``count`` probes over all of the surface that light can reach, on both sides of faces.

    Real meshes are open, or have inconsistent winding: light reaches a point if it sees the sky. Points
    inside other parts are dropped.
    """
    rng = np.random.default_rng([0x9B0B35])
    scattered = _scatter(mesh, POINTS_A_PROBE * count, rng)
    points = _reachable(scattered, caster)
    reached_m2 = 2.0 * mesh.area * len(points.face) / len(scattered.face)
    spacing_m = float(np.sqrt(PACKING * reached_m2 / count))
    probes = points[_poisson_disc_sample(points, spacing_m, rng)]
    around = SurfaceInterpolation(probes.p_G, probes.normal_G, 2.0 * spacing_m)
    owner = around.nearest(points.p_G, points.normal_G).astype(np.int64)
    points, owner = points[owner >= 0], owner[owner >= 0]
    directions = even_directions(DIRECTIONS)
    sees = _seen_from(probes, directions, mesh, caster, around)
    return Probes(points, owner, probes.p_G, probes.normal_G, directions, sees, around)


def _scatter(mesh: trimesh.Trimesh, n: int, rng: np.random.Generator) -> SurfacePoints:
    """Points on both sides of all faces, n on each side, evenly over the area."""
    area = np.cumsum(mesh.area_faces)
    face = np.searchsorted(area, area[-1] * (np.arange(n) + rng.random(n)) / n)
    root, share = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.stack([1.0 - root, root * (1.0 - share), root * share], axis=1)
    p_G = np.einsum("nc,nck->nk", weights, np.asarray(mesh.triangles)[face])
    normal = np.asarray(mesh.face_normals)[face]
    both = [np.concatenate([x, x]) for x in (face, weights, p_G)]
    return SurfacePoints(both[0], both[1], both[2], np.concatenate([normal, -normal]))


def _reachable(points: SurfacePoints, caster: RayCaster) -> SurfacePoints:
    """The points that see the sky; all of them if none does."""
    sky = np.zeros(len(points.face), np.bool_)
    for rays in _rays(points, even_directions(PILOT_DIRECTIONS), caster):
        sky[rays.point[rays.face < 0]] = True
    return points[sky] if sky.any() else points


def _poisson_disc_sample(points: SurfacePoints, spacing_m: float, rng: np.random.Generator) -> Ints:
    """Indices of a Poisson-disc sample: points in random order, without those near an earlier one."""
    order = rng.permutation(len(points.p_G))
    features = np.hstack([points.p_G, NORMAL_FACTOR * spacing_m * points.normal_G])[order]
    pairs = cKDTree(features).query_pairs(spacing_m, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    taken = _greedy(len(order), pairs)
    return np.sort(order[taken])


@compiled
def _greedy(count: int, pairs: Ints) -> Bools:
    """Which of ``count`` points are kept; pairs (m, 2) of near ones, i < j, sorted by i."""
    stays = np.ones(count, np.bool_)
    for m in range(len(pairs)):
        if stays[pairs[m, 0]]:
            stays[pairs[m, 1]] = False
    return stays


def _seen_from(
    points: SurfacePoints,
    directions: Array,
    mesh: trimesh.Trimesh,
    caster: RayCaster,
    around: SurfaceInterpolation,
) -> NDArray[np.int16]:
    """What n points see in D directions (n, D): a point of ``around``, or SKY, BELOW, DARK."""
    sees = np.full((len(points.face), len(directions)), BELOW, np.int16)
    for rays in _rays(points, directions, caster):
        met = np.full(len(rays.face), SKY, np.int32)
        hit = np.flatnonzero(rays.face >= 0)
        toward = directions[rays.direction[hit]]
        normal = np.asarray(mesh.face_normals)[rays.face[hit]]
        side = -np.sign(np.einsum("nk,nk->n", normal, toward))[:, None] * normal
        found = around.nearest(points.p_G[rays.point[hit]] + rays.distance_m[hit, None] * toward, side)
        met[hit] = np.where(found >= 0, found, DARK)
        sees[rays.point, rays.direction] = met
    return sees


@dataclass(frozen=True)
class _Rays:
    """First hits of m rays."""

    point: Ints
    """(m,) index of the point where each starts"""
    direction: Ints
    """(m,)"""
    face: Ints
    """(m,) -1: none"""
    distance_m: Array
    """(m,)"""


def _rays(points: SurfacePoints, directions: Array, caster: RayCaster) -> Iterator[_Rays]:
    """All rays from points in directions above their horizons, in batches."""
    rows = max(RAYS_AT_ONCE // len(directions), 1)
    for first in range(0, len(points.face), rows):
        point, direction = np.nonzero(points.normal_G[first : first + rows] @ directions.T > LOWEST)
        point += first
        met = caster.meets(points.p_G[point], points.normal_G[point], directions[direction])
        yield _Rays(point, direction, *met)
