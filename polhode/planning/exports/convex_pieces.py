"""Convex pieces that together contain the surface: collision geometry for planners.

The pieces come from V-HACD (Mamou and Ghorbel, "A simple and efficient approach for 3D mesh approximate
convex decomposition", 2009), where it is installed; otherwise there is one, the convex hull. V-HACD splits
the voxels of a simplified mesh, so its pieces may lie inside the surface, which is the unsafe side. Therefore
each triangle of the full mesh is assigned to the piece that it protrudes from least, and the piece becomes
the hull of its triangles and of its own points inside the body: the union contains every triangle by
construction.

Pieces that protrude too far from the surface are then split by planes until they do not. A plane cuts
triangles exactly, so the pieces still contain the surface after each split. Among a few planes, through the
bottom of the concavity that the piece bridges and through its centre, the one is taken whose halves protrude
least (as in approximate convex decomposition: Lien and Amato, Computational Geometry 35, 2006).
"""

import heapq
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError, cKDTree
from trimesh.sample import sample_surface

from polhode.geometry.lie import Array, Bools, Ints
from polhode.runtime.optional_parts import missing_message

VOXELS = 400_000
"""Of V-HACD."""
MAX_PROTRUSION_SHARE = 0.01
"""Of the body's diameter: pieces that protrude farther from the surface are split."""
DIRECTIONS = trimesh.creation.icosphere(1).vertices
"""Rays that decide whether a point lies inside."""
PANEL_THICKNESS_SHARE = 1e-3
"""Thickness of a flat piece, over the body's size."""


class OutwardDistance:
    """Distance of points from a surface, outwards; 0 inside."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        """Sample the surface: faces may be long, so their corners alone do not represent it."""
        # relative to its centre: rays are of single precision
        self._centre = np.asarray(mesh.bounds.mean(axis=0))
        V = np.asarray(mesh.vertices) - self._centre
        self._mesh = trimesh.Trimesh(V, np.asarray(mesh.faces), process=False)
        self.size_m = float(np.ptp(V, axis=0).max())
        points, face = sample_surface(mesh, 100_000, seed=0)
        # slivers and needles have no area to be sampled
        self._on = np.concatenate([np.asarray(points), np.asarray(mesh.vertices)])
        self._normal = np.concatenate([np.asarray(mesh.face_normals)[face], np.asarray(mesh.vertex_normals)])
        self._tree = cKDTree(self._on)

    def of(self, points: Array) -> tuple[Array, Array, Array]:
        """Of points (n, 3): distance (n,) [m], nearest surface point (n, 3), normal there (n, 3).

        A point is outside if it lies in front of the nearest surface point, and if at most half of the rays
        from it hit the surface's back, as the nearest normal errs deep inside, beside edges and fragments.
        """
        distance, near = self._tree.query(points)
        before = np.sum((points - self._on[near]) * self._normal[near], axis=1) > 0.0
        far = np.flatnonzero(before & (distance > 0.002 * self.size_m))
        start = np.repeat(points[far] - self._centre, len(DIRECTIONS), axis=0)
        along = np.tile(DIRECTIONS, (len(far), 1))
        face = self._mesh.ray.intersects_first(start, along)
        facing = np.einsum("ij,ij->i", self._mesh.face_normals[face], along)
        back = ((face >= 0) & (facing > 0.0)).reshape(len(far), len(DIRECTIONS))
        before[far] = back.mean(axis=1) <= 0.5
        return np.where(before, distance, 0.0), self._on[near], self._normal[near]

    def inside(self, points: Array) -> Array:
        """Those of the points (n, 3) that are not outside."""
        return np.asarray(points[self.of(points)[0] == 0.0])


@dataclass(frozen=True)
class ConvexPiece:
    """A convex hull and how far it protrudes from the surface."""

    triangles: Array
    """(n, 3, 3) of the surface"""
    inner: Array
    """(m, 3) points inside the body"""
    hull: ConvexHull
    worst_m: float
    """Largest protrusion of the sampled points"""
    mean_m: float
    dent: Array
    """(3,) surface point nearest to the worst point"""
    dent_normal: Array
    """(3,)"""

    @property
    def corners(self) -> Array:
        """(k, 3) of the hull"""
        return np.asarray(self.hull.points[self.hull.vertices])


@dataclass(frozen=True)
class Decomposition:
    """Convex pieces in F."""

    pieces: tuple[trimesh.Trimesh, ...]
    description: str
    """How they were made, and how far they protrude from the surface"""
    max_beyond_m: float
    """Largest protrusion found"""
    far_share: float
    """Share of their area that protrudes by more than MAX_PROTRUSION_SHARE of the diameter"""
    diameter_m: float
    """Of the surface: its two points farthest from each other"""


def decompose(
    surface: trimesh.Trimesh, max_pieces: int, body: trimesh.Trimesh | None = None
) -> Decomposition:
    """Decompose, grow, split. Raises ValueError when the points are coplanar: there is no volume.

    The pieces contain all triangles of ``surface``, fill the body and protrude from it as little as they can;
    body: its closed surface, None: ``surface`` itself.
    """
    points, mesh = np.asarray(surface.vertices)[np.unique(surface.faces)], surface if body is None else body
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError as error:
        raise ValueError("the surface is flat: it has no convex hull with a volume") from error
    diameter = float(max(np.linalg.norm(corners - each, axis=1).max() for each in corners))
    outward = OutwardDistance(mesh)
    seeds, words = _initial_pieces(mesh, min(max(max_pieces // 4, 2), 32, max_pieces))
    pieces = [corners]
    if seeds:
        # a tenth less, as the protrusion is evaluated at some points only
        within_m = 0.9 * MAX_PROTRUSION_SHARE * diameter
        grown = split_until_near(_grown_pieces(surface, seeds, outward), outward, within_m, max_pieces)
        pieces = [each.corners for each in grown]
    hulls = []
    for each in pieces:
        # each vertex is moved away from the centroid, by more than the rounding to single precision
        corners = each[ConvexHull(each).vertices]
        away = corners - corners.mean(axis=0)
        away *= 2e-6 * outward.size_m / np.linalg.norm(away, axis=1, keepdims=True)
        hulls.append(trimesh.convex.convex_hull(corners + away))
    count = "the convex hull" if len(hulls) == 1 else f"{len(hulls)} convex pieces"
    beyond = _beyond(hulls, outward)
    largest_m, far_share = float(beyond.max()), float(np.mean(beyond > MAX_PROTRUSION_SHARE * diameter))
    description = (
        f"collision geometry: {count} {words}; they protrude from the surface by at most "
        f"{1e3 * largest_m:.2g} mm, {largest_m / diameter:.1%} of its diameter; 95 % of their area by less "
        f"than {1e3 * float(np.quantile(beyond, 0.95)):.2g} mm, and {far_share:.2%} of it by more than "
        f"{MAX_PROTRUSION_SHARE:.0%} of the diameter"
    )
    return Decomposition(tuple(hulls), description, largest_m, far_share, diameter)


def _initial_pieces(mesh: trimesh.Trimesh, max_pieces: int) -> tuple[list[Array], str]:
    """Vertices of convex pieces, and how they were found."""
    if max_pieces == 1:
        return [], "as one piece was asked for"
    try:
        import vhacdx
    except ImportError:
        return [], f"alone, as {missing_message('vhacdx')}"
    if mesh.is_volume and mesh.convex_hull.volume < 1.01 * mesh.volume:
        return [], "as the body is convex"
    thin = mesh if len(mesh.faces) <= 12_000 else mesh.simplify_quadric_decimation(face_count=12_000)
    parts = vhacdx.compute_vhacd(
        np.asarray(thin.vertices, dtype=np.float64),
        np.asarray(thin.faces, dtype=np.uint32),
        maxConvexHulls=max_pieces,
        resolution=VOXELS,
        minimumVolumePercentErrorAllowed=0.5,
        asyncACD=False,
    )
    thickness_m = PANEL_THICKNESS_SHARE * float(np.ptp(np.asarray(mesh.vertices), axis=0).max())
    found = [_with_volume(np.asarray(vertices, dtype=np.float64), thickness_m) for vertices, _ in parts]
    found = [vertices for vertices in found if _has_volume(vertices)]
    return found, "by V-HACD, grown until they contain the surface and split where they protrude far from it"


def _grown_pieces(
    surface: trimesh.Trimesh, seeds: list[Array], outward: OutwardDistance
) -> list[ConvexPiece]:
    """Each piece with the triangles assigned to it, and with its points inside the body.

    A sliver between two other pieces attracts triangles from all around it: pieces that grow out of
    proportion are left out, and their triangles are assigned to the others.
    """
    hulls = [ConvexHull(seed) for seed in seeds]
    used, index = np.unique(surface.faces, return_inverse=True)
    corner: Ints = index.reshape(-1, 3)
    points = np.asarray(surface.vertices)[used]
    # protrusion of each triangle from each piece (T, pieces): the largest over its corners
    leaves = np.stack([outside(points, hull.equations)[corner].max(axis=1) for hull in hulls], axis=1)
    kept = np.arange(len(seeds))
    while True:
        owner = kept[leaves[:, kept].argmin(axis=1)]
        volumes = [
            ConvexHull(np.concatenate([seeds[k], points[np.unique(corner[owner == k])]])).volume for k in kept
        ]
        sound = np.array([v < 10.0 * hulls[k].volume for k, v in zip(kept, volumes, strict=True)])
        if sound.all() or not sound.any():
            break
        kept = kept[sound]
    rng, pieces = np.random.default_rng(1), []
    for k in kept:
        mixed = rng.dirichlet(np.full(len(seeds[k]), 0.3), 200) @ seeds[k]
        inner = outward.inside(np.concatenate([seeds[k], mixed]))
        triangles = points[corner[owner == k]]
        if len(triangles) or len(inner) > 3:
            pieces.append(_convex_piece(triangles, inner, outward))
    return pieces


def _beyond(hulls: list[trimesh.Trimesh], outward: OutwardDistance) -> Array:
    """Protrusion from the surface [m] of points on the pieces that no other piece covers."""
    planes = [ConvexHull(np.asarray(hull.vertices)).equations for hull in hulls]
    boxes = np.stack([np.asarray(hull.bounds) for hull in hulls])
    areas = np.array([hull.area for hull in hulls])
    found = []
    for k, hull in enumerate(hulls):
        count = max(20, round(20_000 * areas[k] / areas.sum()))
        points = np.asarray(sample_surface(hull, count, seed=0)[0])
        meets = (boxes[:, 0] <= boxes[k, 1]).all(axis=1) & (boxes[:, 1] >= boxes[k, 0]).all(axis=1)
        meets[k] = False
        covered: Bools = np.zeros(len(points), dtype=bool)
        for other in np.flatnonzero(meets):
            covered |= outside(points, planes[other]) < 0.0
        found.append(outward.of(points[~covered])[0])
    return np.concatenate(found)


def _convex_piece(
    triangles: Array, inner: Array, outward: OutwardDistance, samples: int = 250
) -> ConvexPiece:
    """Raises QhullError when there are too few points."""
    points = np.concatenate([triangles.reshape(-1, 3), inner])
    hull = ConvexHull(_with_volume(points, PANEL_THICKNESS_SHARE * outward.size_m))
    # points on its faces, the same for the same hull
    corner = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    rng = np.random.default_rng(0)
    a, b, c = np.swapaxes(corner[rng.choice(len(corner), samples, p=area / area.sum())], 0, 1)
    share = rng.random((samples, 2))
    share = np.where(share.sum(axis=1, keepdims=True) > 1.0, 1.0 - share, share)
    beyond, nearest, normal = outward.of(a + share[:, :1] * (b - a) + share[:, 1:] * (c - a))
    k = int(beyond.argmax())
    return ConvexPiece(triangles, inner, hull, float(beyond[k]), float(beyond.mean()), nearest[k], normal[k])


def split_until_near(
    pieces: list[ConvexPiece], outward: OutwardDistance, within_m: float, most: int
) -> list[ConvexPiece]:
    """Split the worst piece repeatedly until all protrude less or there are ``most``."""
    waiting = [(-piece.worst_m, number, piece) for number, piece in enumerate(pieces)]
    heapq.heapify(waiting)
    number, done, confirmed = len(waiting), list[ConvexPiece](), set[int]()
    while waiting and len(waiting) + len(done) < most:
        worst, own, piece = heapq.heappop(waiting)
        if -worst <= within_m:
            if own in confirmed:
                done.append(piece)
                continue
            halves = [_convex_piece(piece.triangles, piece.inner, outward, 2_000)]
            confirmed.add(number)
        elif len(piece.triangles) == 0:
            # without a part of the surface it only fills the inside, as others do
            continue
        else:
            halves = _best_split(piece, outward)
            if not halves:
                done.append(piece)
        for half in halves:
            heapq.heappush(waiting, (-half.worst_m, number, half))
            number += 1
    return done + [each[2] for each in sorted(waiting, key=lambda each: each[1])]


def _best_split(piece: ConvexPiece, outward: OutwardDistance) -> list[ConvexPiece]:
    """By the best of some planes; empty: none splits it. Inside the body both halves extend to the plane."""
    corners = piece.corners
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    axes = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    along = np.linalg.svd(piece.dent_normal[None])[2][1:]
    planes = [(n, float(n @ at)) for n in axes for at in (piece.dent, centre)]
    planes += [(n, float(n @ piece.dent)) for n in along]
    best, found = np.inf, list[ConvexPiece]()
    for n, offset in planes:
        height = corners @ n - offset
        if min(height.max(), -height.min()) < PANEL_THICKNESS_SHARE * outward.size_m:
            continue
        below, above = clip(piece.triangles, n, offset)
        height = piece.inner @ n - offset
        low, high = piece.inner[height <= 0.0], piece.inner[height > 0.0]
        if count := min(len(low), len(high), 60):
            a, b = low[:count], high[-count:]
            section = outward.inside(a + ((offset - a @ n) / ((b - a) @ n))[:, None] * (b - a))
            low, high = np.concatenate([section, low]), np.concatenate([high, section])
        sides = [each for each in ((below, low), (above, high)) if len(each[0]) or len(each[1]) > 3]
        try:
            halves = [_convex_piece(triangles, inner, outward) for triangles, inner in sides]
        except QhullError:
            continue
        if halves:
            mean = sum(half.mean_m * half.hull.area for half in halves) / piece.hull.area
            cost = max(half.worst_m for half in halves) + 2.0 * mean
            if cost < best:
                best, found = cost, halves
    return found


def clip(triangles: Array, n: Array, offset: float) -> tuple[Array, Array]:
    """Triangles (k, 3, 3) below and above the plane n . p = offset; those that cross it are cut."""
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


def _with_volume(points: Array, thickness_m: float) -> Array:
    """The points; those of a panel seen from one side, which has no volume, as two sheets."""
    if _has_volume(points):
        return points
    across = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    return np.concatenate([points - 0.5 * thickness_m * across, points + 0.5 * thickness_m * across])


def _has_volume(points: Array) -> bool:
    try:
        return bool(ConvexHull(points).volume > 0.0)
    except (QhullError, ValueError):
        return False


def outside(points: Array, planes: Array) -> Array:
    """(V,) largest signed distance to the planes (K, 4) of a hull; <= 0 inside."""
    out = np.full(len(points), -np.inf)
    for some in np.split(planes, range(64, len(planes), 64)):
        out = np.maximum(out, (points @ some[:, :3].T + some[:, 3]).max(axis=1))
    return out
