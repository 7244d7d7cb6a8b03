"""Convex pieces that reach too far beyond a surface, cut by planes until they do not.

A piece is the convex hull of its share of the surface's triangles and of some points inside the body. A plane
cuts triangles exactly, so the pieces contain the surface after each cut as they did before. Of a few planes,
through the bottom of the dent that the piece bridges and through its middle, that one is taken that leaves
least beyond the surface (as in approximate convex decomposition: Lien and Amato, Computational Geometry 35,
2006).
"""

import heapq
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError, cKDTree

from polhode.lie import Array
from polhode.records import Bools

SURFACE_SAMPLES = 100_000
PIECE_SAMPLES = 250
"""Points of a piece whose distance from the surface is looked at, at each cut."""
SURE_SAMPLES = 2_000
"""The same once no piece seems to reach too far."""
DIRECTIONS = trimesh.creation.icosphere(1).vertices
"""Lines of sight that tell whether a point lies inside."""
AREA_WEIGHT = 2.0
"""Of the mean reach against the largest, when planes are compared."""
SECTION_POINTS = 60
PANEL = 1e-3
"""Thickness of a flat piece, over the body's size."""


class Reach:
    """How far points reach beyond a surface, outwards."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        """Samples the surface: faces may be long, so their corners alone would not tell where it is."""
        # about its middle: rays are of single precision
        self._middle = np.asarray(mesh.bounds.mean(axis=0))
        V = np.asarray(mesh.vertices) - self._middle
        self._mesh = trimesh.Trimesh(V, np.asarray(mesh.faces), process=False)
        self.size_m = float(np.ptp(V, axis=0).max())
        points, face = trimesh.sample.sample_surface(mesh, SURFACE_SAMPLES, seed=0)
        # slivers and needles have no area to be sampled
        self._on = np.concatenate([np.asarray(points), np.asarray(mesh.vertices)])
        self._normal = np.concatenate([np.asarray(mesh.face_normals)[face], np.asarray(mesh.vertex_normals)])
        self._tree = cKDTree(self._on)

    def of(self, points: Array, sure: bool = False) -> tuple[Array, Array, Array]:
        """Of points (n, 3): distance beyond (n,) [m], 0 inside; nearest place of the surface (n, 3), normal
        there (n, 3).

        Outside is what lies before the nearest place; ``sure``: and does not look at the surface's back all
        around, as the nearest normal errs deep inside, beside edges and fragments.
        """
        distance, near = self._tree.query(points)
        before = np.sum((points - self._on[near]) * self._normal[near], axis=1) > 0.0
        if sure:
            far = np.flatnonzero(before & (distance > 0.002 * self.size_m))
            before[far] = self._in_front(points[far])
        return np.where(before, distance, 0.0), self._on[near], self._normal[near]

    def _in_front(self, points: Array) -> Bools:
        """Whether at most half of the directions look at the surface's back."""
        start = np.repeat(points - self._middle, len(DIRECTIONS), axis=0)
        along = np.tile(DIRECTIONS, (len(points), 1))
        face = self._mesh.ray.intersects_first(start, along)
        facing = np.einsum("ij,ij->i", self._mesh.face_normals[face], along)
        back = ((face >= 0) & (facing > 0.0)).reshape(len(points), len(DIRECTIONS))
        return np.asarray(back.mean(axis=1) <= 0.5)


@dataclass(frozen=True)
class Piece:
    """A convex hull and how far it reaches."""

    triangles: Array
    """(n, 3, 3) of the surface"""
    inner: Array
    """(m, 3) points inside the body"""
    hull: ConvexHull
    worst_m: float
    """Farthest beyond the surface, of the points looked at"""
    mean_m: float
    dent: Array
    """(3,) the surface's place nearest to the worst point"""
    dent_normal: Array
    """(3,)"""

    @property
    def corners(self) -> Array:
        """(k, 3) of the hull"""
        return np.asarray(self.hull.points[self.hull.vertices])


def piece_of(triangles: Array, inner: Array, reach: Reach, samples: int = PIECE_SAMPLES) -> Piece:
    """Raises QhullError when there are too few points."""
    points = with_volume(np.concatenate([triangles.reshape(-1, 3), inner]), PANEL * reach.size_m)
    hull = ConvexHull(points)
    beyond, place, normal = reach.of(_on_hull(hull, samples), sure=True)
    k = int(beyond.argmax())
    return Piece(triangles, inner, hull, float(beyond[k]), float(beyond.mean()), place[k], normal[k])


def cut_until_near(pieces: list[Piece], reach: Reach, within_m: float, most: int) -> list[Piece]:
    """The worst piece is cut, and the worst then, until all reach less far or there are so many."""
    waiting = [(-piece.worst_m, number, piece) for number, piece in enumerate(pieces)]
    heapq.heapify(waiting)
    number, done, sure = len(waiting), list[Piece](), set[int]()
    while waiting and len(waiting) + len(done) < most:
        worst, own, piece = heapq.heappop(waiting)
        if -worst <= within_m and own in sure:
            done.append(piece)
            continue
        if -worst > within_m and len(piece.triangles) == 0:
            # it holds nothing of the surface, and fills the inside where others do
            continue
        halves: list[Piece] | None
        if -worst > within_m:
            halves = _halves(piece, reach)
        else:
            halves = [piece_of(piece.triangles, piece.inner, reach, SURE_SAMPLES)]
            sure.add(number)
        if halves is None:
            done.append(piece)
            continue
        for half in halves:
            heapq.heappush(waiting, (-half.worst_m, number, half))
            number += 1
    return done + [each[2] for each in sorted(waiting, key=lambda each: each[1])]


def _halves(piece: Piece, reach: Reach) -> list[Piece] | None:
    """By the best of some planes; None: none cuts it."""
    corners = piece.corners
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    axes = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    along = np.linalg.svd(piece.dent_normal[None])[2][1:]
    planes = [(n, float(n @ at)) for n in axes for at in (piece.dent, middle)]
    planes += [(n, float(n @ piece.dent)) for n in along]
    best, found = np.inf, None
    for n, offset in planes:
        height = corners @ n - offset
        if min(height.max(), -height.min()) < PANEL * reach.size_m:
            continue
        try:
            halves = _cut(piece, n, offset, reach)
        except QhullError:
            continue
        if not halves:
            continue
        mean = sum(half.mean_m * half.hull.area for half in halves) / piece.hull.area
        cost = max(half.worst_m for half in halves) + AREA_WEIGHT * mean
        if cost < best:
            best, found = cost, halves
    return found


def _cut(piece: Piece, n: Array, offset: float, reach: Reach) -> list[Piece]:
    """Both sides of the plane; inside the body both reach up to it."""
    below, above = clip(piece.triangles, n, offset)
    height = piece.inner @ n - offset
    low, high = piece.inner[height <= 0.0], piece.inner[height > 0.0]
    count = min(len(low), len(high), SECTION_POINTS)
    if count:
        a, b = low[:count], high[-count:]
        share = (offset - a @ n) / ((b - a) @ n)
        section = a + share[:, None] * (b - a)
        section = section[reach.of(section, sure=True)[0] == 0.0]
        low, high = np.concatenate([section, low]), np.concatenate([high, section])
    sides = [(below, low), (above, high)]
    kept = [(tri, inner) for tri, inner in sides if len(tri) or len(inner) > 3]
    return [piece_of(tri, inner, reach) for tri, inner in kept]


def clip(triangles: Array, n: Array, offset: float) -> tuple[Array, Array]:
    """Triangles (k, 3, 3) below and above the plane n . p = offset; those across it are cut."""
    height = triangles @ n - offset
    over = height > 0.0
    count = over.sum(axis=1)
    below, above = [triangles[count == 0]], [triangles[count == 3]]
    for alone_above in (True, False):
        some = count == (1 if alone_above else 2)
        t, h = triangles[some], height[some]
        row = np.arange(len(t))
        # the corner that is alone on its side, and the other two
        k = (over[some] == alone_above).argmax(axis=1)
        p, a, b = t[row, k], t[row, (k + 1) % 3], t[row, (k + 2) % 3]
        hp, ha, hb = h[row, k], h[row, (k + 1) % 3], h[row, (k + 2) % 3]
        on_a = p + (hp / (hp - ha))[:, None] * (a - p)
        on_b = p + (hp / (hp - hb))[:, None] * (b - p)
        tip = np.stack([p, on_a, on_b], axis=1)
        rest = np.concatenate([np.stack([a, b, on_a], axis=1), np.stack([b, on_b, on_a], axis=1)])
        (above if alone_above else below).append(tip)
        (below if alone_above else above).append(rest)
    return np.concatenate(below), np.concatenate(above)


def with_volume(points: Array, thickness_m: float) -> Array:
    """The points; of a panel seen from one side, which has no volume, two sheets of them."""
    if has_volume(points):
        return points
    across = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    return np.concatenate([points - 0.5 * thickness_m * across, points + 0.5 * thickness_m * across])


def has_volume(points: Array) -> bool:
    """Whether their hull does."""
    try:
        return bool(ConvexHull(points).volume > 0.0)
    except (QhullError, ValueError):
        return False


def outside(points: Array, planes: Array) -> Array:
    """(V,) largest signed distance to the planes (K, 4) of a hull; <= 0 inside."""
    out = np.full(len(points), -np.inf)
    for start in range(0, len(planes), 64):
        some = planes[start : start + 64]
        out = np.maximum(out, (points @ some[:, :3].T + some[:, 3]).max(axis=1))
    return out


def _on_hull(hull: ConvexHull, count: int) -> Array:
    """Points (count, 3) on its faces; the same for the same hull."""
    corner = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(corner), count, p=area / area.sum())
    share = rng.random((count, 2))
    over = share.sum(axis=1) > 1.0
    share[over] = 1.0 - share[over]
    a, b, c = corner[face, 0], corner[face, 1], corner[face, 2]
    return np.asarray(a + share[:, :1] * (b - a) + share[:, 1:] * (c - a))
