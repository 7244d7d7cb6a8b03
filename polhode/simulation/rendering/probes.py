"""Probes spread over the body's surface, what each sees in every direction, and interpolation between them.

They are built once per body. The light of a frame then comes from table look-ups, free of noise. A point
contributes to an interpolated value if it is near, faces the same way, and lies in the same plane. All points
within reach contribute, with weights that fall to zero at the limit, so that the result is continuous and
does not leak around edges. Small parts without points of their own take the value of the nearest one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array, Bools, Ints
from polhode.runtime.compiled import compiled
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.sampling import even_directions

MIN_AGREEMENT = 0.3
"""Neighbours whose normals have a smaller cosine do not contribute."""
OFF_PLANE_FACTOR = 3.0
"""Factor on distances off the tangent plane, relative to distances within it."""
MAX_GRID_CELLS = 128
MAX_NEIGHBOURS = 12


@dataclass(frozen=True)
class Neighbours:
    """The points that contribute at each of n positions, and their weights."""

    index: NDArray[np.int32]
    """(n, K) of N points"""
    weight: NDArray[np.float32]
    """(n, K) adds up to 1; 0 where unused; all 0 where no point contributes"""

    def mean(self, values: NDArray[np.float32]) -> Array:
        """Mean (n, C) of the points' values (N, C); zero where no point contributes."""
        return np.asarray(_blend(self.index, self.weight, values))


class _Grid(NamedTuple):
    """Points with normals, and for each cell of a regular grid the points within reach of it."""

    p_G: Array
    """(N, 3) [m]"""
    normal_G: Array
    """(N, 3) unit"""
    reach_m: float
    low: Array
    """(3,) lower corner of the grid [m]"""
    cell_m: float
    shape: Ints
    """(3,) cells along each axis"""
    start: Ints
    """(cells + 1,) the points of a cell are member[start[cell]:start[cell + 1]]"""
    member: Ints


class SurfaceInterpolation:
    """Interpolation between points (N, 3) [m] with unit normals (N, 3) within a distance ``reach_m``."""

    def __init__(self, p_G: Array, normal_G: Array, reach_m: float) -> None:
        p, n = np.ascontiguousarray(p_G), np.ascontiguousarray(normal_G)
        low, high = p_G.min(axis=0) - reach_m, p_G.max(axis=0) + reach_m
        cell_m = max(0.5 * reach_m, float((high - low).max()) / MAX_GRID_CELLS)
        shape = np.ceil((high - low) / cell_m).astype(np.int64)
        cells = _fill_cells(p, low, cell_m, shape, reach_m)
        self._grid = _Grid(p, n, reach_m, low, cell_m, shape, *cells)

    def nearest(self, p_G: Array, normal_G: Array) -> NDArray[np.int32]:
        """The point (n,) of the largest weight at p_G (n, 3) with unit normals (n, 3); -1: none."""
        return np.asarray(_nearest(p_G, normal_G, self._grid))

    def near(self, p_G: Array, normal_G: Array) -> "Neighbours":
        """The points that contribute at p_G (n, 3) with unit normals (n, 3)."""
        return Neighbours(*_near(p_G, normal_G, self._grid))


@compiled
def _fill_cells(p: Array, low: Array, cell_m: float, shape: Ints, reach_m: float) -> tuple[Ints, Ints]:
    """For each cell of the grid, the points that reach into it: members[start[cell]:start[cell + 1]]."""
    count = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for turn in range(2):
        if turn == 1:
            start = np.cumsum(count)
            members = np.empty(start[-1], np.int64)
            count[:] = 0
        for m in range(len(p)):
            first = np.empty(3, np.int64)
            last = np.empty(3, np.int64)
            for k in range(3):
                first[k] = max(int((p[m, k] - reach_m - low[k]) / cell_m), 0)
                last[k] = min(int((p[m, k] + reach_m - low[k]) / cell_m), shape[k] - 1)
            for i in range(first[0], last[0] + 1):
                for j in range(first[1], last[1] + 1):
                    for h in range(first[2], last[2] + 1):
                        gap = 0.0
                        for k, index in ((0, i), (1, j), (2, h)):
                            edge = low[k] + index * cell_m
                            gap += max(edge - p[m, k], p[m, k] - edge - cell_m, 0.0) ** 2
                        if gap > reach_m * reach_m:
                            continue
                        cell = (i * shape[1] + j) * shape[2] + h
                        if turn == 1:
                            members[start[cell] + count[cell + 1]] = m
                        count[cell + 1] += 1
    return start, members


@compiled
def _cell_of(p: Array, a: int, grid: _Grid) -> int:
    """The cell that contains p[a]; -1: outside the grid."""
    cell = 0
    for k in range(3):
        along = (p[a, k] - grid.low[k]) / grid.cell_m
        if along < 0.0 or along >= grid.shape[k]:
            return -1
        cell = cell * grid.shape[k] + int(along)
    return cell


@compiled
def _weight(p: Array, n: Array, a: int, grid: _Grid, i: int) -> float:
    """Weight of the grid's point i at p[a] with normal n[a]."""
    q, m, reach2 = grid.p_G, grid.normal_G, grid.reach_m * grid.reach_m
    dx, dy, dz = p[a, 0] - q[i, 0], p[a, 1] - q[i, 1], p[a, 2] - q[i, 2]
    square = dx * dx + dy * dy + dz * dz
    if square >= reach2:
        return 0.0
    agreement = n[a, 0] * m[i, 0] + n[a, 1] * m[i, 1] + n[a, 2] * m[i, 2]
    if agreement <= MIN_AGREEMENT:
        return 0.0
    step = abs(dx * n[a, 0] + dy * n[a, 1] + dz * n[a, 2]) + abs(dx * m[i, 0] + dy * m[i, 1] + dz * m[i, 2])
    square += 0.25 * (OFF_PLANE_FACTOR * OFF_PLANE_FACTOR - 1.0) * step * step
    if square >= reach2:
        return 0.0
    near, alike = 1.0 - square / reach2, (agreement - MIN_AGREEMENT) / (1.0 - MIN_AGREEMENT)
    return float(near * near * alike * alike)


@compiled
def _nearest(p: Array, n: Array, grid: _Grid) -> NDArray[np.int32]:
    out = np.full(len(p), -1, np.int32)
    for a in range(len(p)):
        cell = _cell_of(p, a, grid)
        if cell < 0:
            continue
        best = 0.0
        for at in range(grid.start[cell], grid.start[cell + 1]):
            w = _weight(p, n, a, grid, grid.member[at])
            if w > best:
                best = w
                out[a] = grid.member[at]
    return out


@compiled
def _near(p: Array, n: Array, grid: _Grid) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    index = np.zeros((len(p), MAX_NEIGHBOURS), np.int32)
    weight = np.zeros((len(p), MAX_NEIGHBOURS), np.float32)
    for a in range(len(p)):
        cell = _cell_of(p, a, grid)
        if cell < 0:
            continue
        total, used = 0.0, 0
        for at in range(grid.start[cell], grid.start[cell + 1]):
            w = _weight(p, n, a, grid, grid.member[at])
            if w <= 0.0:
                continue
            slot = used
            if used == MAX_NEIGHBOURS:
                slot = 0
                for k in range(1, MAX_NEIGHBOURS):
                    if weight[a, k] < weight[a, slot]:
                        slot = k
                if weight[a, slot] >= w:
                    continue
                total -= weight[a, slot]
            else:
                used += 1
            index[a, slot], weight[a, slot] = grid.member[at], w
            total += w
        for k in range(used):
            weight[a, k] /= total
        if used == 0:
            index[a, 0], weight[a, 0] = _next_best(p, n, a, grid, cell)
    return index, weight


@compiled
def _next_best(p: Array, n: Array, a: int, grid: _Grid, cell: int) -> tuple[int, float]:
    """Where no point contributes: the nearest one that faces the same half space, with weight 1; 0: none."""
    q, m = grid.p_G, grid.normal_G
    nearest, found, share = np.inf, 0, 0.0
    for i in grid.member[grid.start[cell] : grid.start[cell + 1]]:
        square = (p[a, 0] - q[i, 0]) ** 2 + (p[a, 1] - q[i, 1]) ** 2 + (p[a, 2] - q[i, 2]) ** 2
        facing = n[a, 0] * m[i, 0] + n[a, 1] * m[i, 1] + n[a, 2] * m[i, 2]
        if facing > 0.0 and square < nearest:
            nearest, found, share = square, i, 1.0
    return found, share


@compiled
def _blend(index: NDArray[np.int32], weight: NDArray[np.float32], values: NDArray[np.float32]) -> Array:
    out = np.zeros((len(index), values.shape[1]))
    for n in range(len(index)):
        for k in range(MAX_NEIGHBOURS):
            if weight[n, k] > 0.0:
                for c in range(values.shape[1]):
                    out[n, c] += weight[n, k] * values[index[n, k], c]
    return out


SKY, BELOW, DARK = -1, -2, -3
"""Entries of the table apart from probes: open sky; below the probe's own horizon; an unlit surface."""
PROBES = 5000
POINTS_A_PROBE = 6
"""Points on the whole surface, inside and out, for each probe on the surface that light reaches."""
DIRECTIONS = 1024


@dataclass(frozen=True)
class Probes:
    """P probes, D directions."""

    points: Hits
    """(M,) points on the surface, of equal share in its area, for means around the probes"""
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
    scattered = _scatter(mesh, caster, POINTS_A_PROBE * count, rng)
    points = _reachable(scattered, caster)
    reached_m2 = 2.0 * mesh.area * len(points.face) / len(scattered.face)
    # A square with the spacing as its side holds 0.6 probes.
    spacing_m = float(np.sqrt(0.6 * reached_m2 / count))
    probes = points[_poisson_disc_sample(points, spacing_m, rng)]
    around = SurfaceInterpolation(probes.p_G, probes.flat_normal_G, 2.0 * spacing_m)
    owner = around.nearest(points.p_G, points.flat_normal_G).astype(np.int64)
    points, owner = points[owner >= 0], owner[owner >= 0]
    directions = even_directions(DIRECTIONS)
    sees = _seen_from(probes, directions, mesh, caster, around)
    return Probes(points, owner, probes.p_G, probes.flat_normal_G, directions, sees, around)


def _scatter(mesh: trimesh.Trimesh, caster: RayCaster, n: int, rng: np.random.Generator) -> Hits:
    """Points on both sides of all faces, n on each side, evenly over the area."""
    area = np.cumsum(mesh.area_faces)
    face = np.searchsorted(area, area[-1] * (np.arange(n) + rng.random(n)) / n)
    root, share = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.stack([1.0 - root, root * (1.0 - share), root * share], axis=1)
    normal = np.asarray(mesh.face_normals)[face]
    sides = np.concatenate([normal, -normal])
    return caster.hits_at(np.concatenate([face, face]), np.concatenate([weights, weights]), sides)


def _reachable(points: Hits, caster: RayCaster) -> Hits:
    """The points that see the sky; all of them if none does."""
    sky = np.zeros(len(points.face), np.bool_)
    for point, _, face, _ in _rays(points, even_directions(64), caster):
        sky[point[face < 0]] = True
    return points[sky] if sky.any() else points


def _poisson_disc_sample(points: Hits, spacing_m: float, rng: np.random.Generator) -> Ints:
    """Indices of a Poisson-disc sample: points in random order, without those near an earlier one."""
    order = rng.permutation(len(points.p_G))
    # A difference of one radian between normals separates probes like one spacing.
    features = np.hstack([points.p_G, spacing_m * points.flat_normal_G])[order]
    pairs = cKDTree(features).query_pairs(spacing_m, output_type="ndarray")
    stays = np.ones(len(order), np.bool_)
    _drop_second(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))], stays)
    return np.sort(order[stays])


@compiled
def _drop_second(pairs: Ints, stays: Bools) -> None:
    """Of each pair (m, 2), i < j, sorted by i, drop the second if the first stays."""
    for m in range(len(pairs)):
        if stays[pairs[m, 0]]:
            stays[pairs[m, 1]] = False


def _seen_from(
    points: Hits,
    directions: Array,
    mesh: trimesh.Trimesh,
    caster: RayCaster,
    around: SurfaceInterpolation,
) -> NDArray[np.int16]:
    """What n points see in D directions (n, D): a point of ``around``, or SKY, BELOW, DARK."""
    sees = np.full((len(points.face), len(directions)), BELOW, np.int16)
    for point, direction, face, distance_m in _rays(points, directions, caster):
        met = np.full(len(face), SKY, np.int32)
        hit = np.flatnonzero(face >= 0)
        toward = directions[direction[hit]]
        normal = np.asarray(mesh.face_normals)[face[hit]]
        side = -np.sign(np.einsum("nk,nk->n", normal, toward))[:, None] * normal
        found = around.nearest(points.p_G[point[hit]] + distance_m[hit, None] * toward, side)
        met[hit] = np.where(found >= 0, found, DARK)
        sees[point, direction] = met
    return sees


def _rays(points: Hits, directions: Array, caster: RayCaster) -> Iterator[tuple[Ints, Ints, Ints, Array]]:
    """All rays from points in directions above their horizons, in batches of m.

    Yields indices (m,) of the points and directions, the face (m,) that is hit, -1: none, and its distance.
    """
    rows = max((1 << 18) // len(directions), 1)
    for first in range(0, len(points.face), rows):
        point, direction = np.nonzero(points.flat_normal_G[first : first + rows] @ directions.T > 1e-3)
        point += first
        met = caster.meets(points.p_G[point], points.flat_normal_G[point], directions[direction])
        yield point, direction, *met
