"""Convex pieces that together contain the surface: collision geometry for planners.

The pieces come from V-HACD (Mamou and Ghorbel, "A simple and efficient approach for 3D mesh approximate
convex decomposition", 2009), where it is installed; else there is one, the convex hull. V-HACD cuts voxels of
a thinned mesh and may lie inside the surface, which is the dangerous side. So each triangle of the full mesh
is given to the piece that it leaves least, and the piece grows to the hull of both: the union contains every
triangle by construction.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError, cKDTree

from planning.exports.records import Shape
from polhode.lie import Array
from polhode.records import Ints

CUT_FACES = 12_000
"""Of the thinned mesh that is cut."""
VOXELS = 400_000
LEAST_VOLUME_PERCENT = 0.5
"""A piece is cut no more when its hull has so little more volume than its voxels."""
NEARLY_CONVEX = 0.01
"""Share of its volume that the hull of a convex body may have more."""
PANEL = 1e-3
"""Thickness of a flat piece, over the body's size."""
MOST_GROWTH = 10.0
"""Volume of a piece over what it was when it was cut."""
ROUNDING = 2e-6
"""Each piece is larger by this share of the body's size: more than single precision moves it."""
SAMPLES, SURFACE_SAMPLES = 4_000, 60_000


@dataclass(frozen=True)
class Decomposition:
    """Convex pieces in F."""

    pieces: tuple[trimesh.Trimesh, ...]
    words: str
    """How they were made"""
    beyond_m: float
    """How far they reach beyond the surface [m], outwards: 95 % of their area reaches less"""


def decompose(shape: Shape, most_pieces: int) -> Decomposition:
    """Cut and grow. Raises ValueError when the points are flat: there is no volume."""
    points = shape.vertices[np.unique(shape.faces)]
    size = float(np.ptp(points, axis=0).max())
    seeds, words = _cut(shape.mesh(), most_pieces)
    pieces = _grown(shape, seeds) if seeds else [points]
    try:
        hulls = tuple(_hull(each, ROUNDING * size) for each in pieces)
    except QhullError as error:
        raise ValueError("the surface is flat: it has no convex hull with a volume") from error
    pieces_in_words = "the convex hull" if len(hulls) == 1 else f"{len(hulls)} convex pieces"
    return Decomposition(hulls, f"collision geometry: {pieces_in_words} {words}", _beyond(hulls, shape))


def _cut(mesh: trimesh.Trimesh, most_pieces: int) -> tuple[list[Array], str]:
    """Vertices of convex pieces, and how they were found."""
    if most_pieces == 1:
        return [], "as one piece was asked for"
    try:
        import vhacdx
    except ImportError:
        return [], "alone, as V-HACD is not installed (pip install 'polhode[export]')"
    if mesh.is_volume and mesh.convex_hull.volume < (1.0 + NEARLY_CONVEX) * mesh.volume:
        return [], "as the body is convex"
    thin = mesh if len(mesh.faces) <= CUT_FACES else mesh.simplify_quadric_decimation(face_count=CUT_FACES)
    parts = vhacdx.compute_vhacd(
        np.asarray(thin.vertices, dtype=np.float64),
        np.asarray(thin.faces, dtype=np.uint32),
        maxConvexHulls=most_pieces,
        resolution=VOXELS,
        minimumVolumePercentErrorAllowed=LEAST_VOLUME_PERCENT,
        asyncACD=False,
    )
    thickness_m = PANEL * float(np.ptp(np.asarray(mesh.vertices), axis=0).max())
    found = [_with_volume(np.asarray(vertices, dtype=np.float64), thickness_m) for vertices, _ in parts]
    found = [vertices for vertices in found if _has_volume(vertices)]
    return found, "by V-HACD, grown until they contain the surface"


def _with_volume(points: Array, thickness_m: float) -> Array:
    """The points; of a panel seen from one side, which has no volume, two sheets of them."""
    if _has_volume(points):
        return points
    across = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    return np.concatenate([points - 0.5 * thickness_m * across, points + 0.5 * thickness_m * across])


def _has_volume(points: Array) -> bool:
    try:
        return bool(ConvexHull(points).volume > 0.0)
    except QhullError:
        return False


def _grown(shape: Shape, seeds: list[Array]) -> list[Array]:
    """Points of each piece with the corners of the triangles that it takes.

    A sliver between two other pieces takes triangles from all around it: those that grow out of all
    proportion are left out, and the others share what they had.
    """
    hulls = [ConvexHull(seed) for seed in seeds]
    used, index = np.unique(shape.faces, return_inverse=True)
    corner: Ints = index.reshape(-1, 3)
    points = shape.vertices[used]
    # how far each triangle leaves each piece (T, pieces): the largest over its corners
    leaves = np.stack([_outside(points, hull.equations)[corner].max(axis=1) for hull in hulls], axis=1)
    kept = np.arange(len(seeds))
    while True:
        owner = kept[leaves[:, kept].argmin(axis=1)]
        pieces = [np.concatenate([seeds[k], points[np.unique(corner[owner == k])]]) for k in kept]
        sound = np.array(
            [
                ConvexHull(piece).volume < MOST_GROWTH * hulls[k].volume
                for k, piece in zip(kept, pieces, strict=True)
            ]
        )
        if sound.all() or not sound.any():
            return pieces
        kept = kept[sound]


def _outside(points: Array, planes: Array) -> Array:
    """(V,) largest signed distance to the planes (K, 4) of a hull; <= 0 inside."""
    out = np.full(len(points), -np.inf)
    for start in range(0, len(planes), 64):
        some = planes[start : start + 64]
        out = np.maximum(out, (points @ some[:, :3].T + some[:, 3]).max(axis=1))
    return out


def _hull(points: Array, margin_m: float) -> trimesh.Trimesh:
    """The convex hull, each vertex moved away from the middle by ``margin_m``, faces outwards."""
    corners = points[ConvexHull(points).vertices]
    away = corners - corners.mean(axis=0)
    corners = corners + margin_m * away / np.linalg.norm(away, axis=1, keepdims=True)
    hull = ConvexHull(corners)
    used, faces = np.unique(hull.simplices, return_inverse=True)
    faces = faces.reshape(-1, 3)
    corners = corners[used]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inwards = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    return trimesh.Trimesh(corners, faces, process=False)


def _beyond(hulls: tuple[trimesh.Trimesh, ...], shape: Shape) -> float:
    """See ``Decomposition.beyond_m``; of points on the pieces that no other piece covers."""
    # faces may be long: their corners alone would not tell where the surface is
    surface = shape.mesh()
    on, face = trimesh.sample.sample_surface(surface, SURFACE_SAMPLES, seed=0)
    on, normal = np.asarray(on), np.asarray(surface.face_normals)[face]
    tree = cKDTree(on)
    planes = [ConvexHull(np.asarray(hull.vertices)).equations for hull in hulls]
    areas = np.array([hull.area for hull in hulls])
    found = []
    for k, hull in enumerate(hulls):
        count = max(20, round(SAMPLES * areas[k] / areas.sum()))
        points, _ = trimesh.sample.sample_surface(hull, count, seed=0)
        covered = np.zeros(len(points), dtype=bool)
        for other, each in enumerate(planes):
            if other != k:
                covered |= _outside(np.asarray(points), each) < 0.0
        free = np.asarray(points)[~covered]
        distance, near = tree.query(free)
        outside = np.sum((free - on[near]) * normal[near], axis=1) > 0.0
        found.append(np.where(outside, distance, 0.0))
    return float(np.quantile(np.concatenate(found), 0.95))
