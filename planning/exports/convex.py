"""Convex pieces that together contain the surface: collision geometry for planners.

The pieces come from V-HACD (Mamou and Ghorbel, "A simple and efficient approach for 3D mesh approximate
convex decomposition", 2009), where it is installed; else there is one, the convex hull. V-HACD cuts voxels of
a thinned mesh and may lie inside the surface, which is the dangerous side. So each triangle of the full mesh
is given to the piece that it leaves least, and the piece becomes the hull of its triangles and of what it had
inside the body: the union contains every triangle by construction. Pieces that reach too far beyond the
surface are then cut (``convex_cuts``).
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from polhode.lie import Array
from polhode.planning.exports.convex_cuts import (
    PANEL,
    Piece,
    Reach,
    cut_until_near,
    has_volume,
    outside,
    piece_of,
    with_volume,
)
from polhode.planning.exports.records import Shape
from polhode.records import Ints

CUT_FACES = 12_000
"""Of the thinned mesh that V-HACD cuts."""
VOXELS = 400_000
FIRST_PIECES = 32
"""Of V-HACD; more follow where they reach too far."""
LEAST_VOLUME_PERCENT = 0.5
"""A piece is cut no more by V-HACD when its hull has so little more volume than its voxels."""
NEARLY_CONVEX = 0.01
"""Share of its volume that the hull of a convex body may have more."""
WITHIN = 0.01
"""Of the body's diameter: pieces that reach farther beyond the surface are cut."""
LOOKED_AT = 0.9
"""Of that: a cut looks at some points only."""
MOST_GROWTH = 10.0
"""Volume of a piece over what it was when it was cut."""
INNER_SAMPLES = 200
ROUNDING = 2e-6
"""Each piece is larger by this share of the body's size: more than single precision moves it."""
SAMPLES = 20_000


@dataclass(frozen=True)
class Decomposition:
    """Convex pieces in F."""

    pieces: tuple[trimesh.Trimesh, ...]
    words: str
    """How they were made"""
    beyond_m: float
    """How far they reach beyond the surface [m], outwards: 95 % of their area reaches less"""
    most_beyond_m: float
    """The largest found"""
    far_share: float
    """Of their area that reaches farther than WITHIN of the diameter"""
    diameter_m: float
    """Of the surface: its two points farthest from each other"""

    @property
    def reach_words(self) -> str:
        """How far they reach, in words."""
        share = self.most_beyond_m / self.diameter_m
        return (
            f"they reach at most {1e3 * self.most_beyond_m:.2g} mm beyond the surface, {share:.1%} of its "
            f"diameter; 95 % of their area less than {1e3 * self.beyond_m:.2g} mm, and {self.far_share:.2%} "
            f"of it farther than {WITHIN:.0%} of the diameter"
        )


def decompose(shape: Shape, most_pieces: int) -> Decomposition:
    """Cut, grow, cut again. Raises ValueError when the points are flat: there is no volume."""
    points = shape.vertices[np.unique(shape.faces)]
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError as error:
        raise ValueError("the surface is flat: it has no convex hull with a volume") from error
    diameter = float(max(np.linalg.norm(corners - each, axis=1).max() for each in corners))
    reach = Reach(shape.mesh())
    seeds, words = _cut(shape.mesh(), min(max(most_pieces // 4, 2), FIRST_PIECES, most_pieces))
    pieces = [corners]
    if seeds:
        grown = cut_until_near(_grown(shape, seeds, reach), reach, LOOKED_AT * WITHIN * diameter, most_pieces)
        pieces = [each.corners for each in grown]
    hulls = tuple(_hull(each, ROUNDING * reach.size_m) for each in pieces)
    pieces_in_words = "the convex hull" if len(hulls) == 1 else f"{len(hulls)} convex pieces"
    beyond = _beyond(hulls, reach)
    return Decomposition(
        hulls,
        f"collision geometry: {pieces_in_words} {words}",
        float(np.quantile(beyond, 0.95)),
        float(beyond.max()),
        float(np.mean(beyond > WITHIN * diameter)),
        diameter,
    )


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
    found = [with_volume(np.asarray(vertices, dtype=np.float64), thickness_m) for vertices, _ in parts]
    found = [vertices for vertices in found if has_volume(vertices)]
    return found, "by V-HACD, grown until they contain the surface and cut where they reach far beyond it"


def _grown(shape: Shape, seeds: list[Array], reach: Reach) -> list[Piece]:
    """Each piece with the triangles that it takes, and with what it has inside the body.

    A sliver between two other pieces takes triangles from all around it: those that grow out of all
    proportion are left out, and the others share what they had.
    """
    hulls = [ConvexHull(seed) for seed in seeds]
    used, index = np.unique(shape.faces, return_inverse=True)
    corner: Ints = index.reshape(-1, 3)
    points = shape.vertices[used]
    # how far each triangle leaves each piece (T, pieces): the largest over its corners
    leaves = np.stack([outside(points, hull.equations)[corner].max(axis=1) for hull in hulls], axis=1)
    kept = np.arange(len(seeds))
    while True:
        owner = kept[leaves[:, kept].argmin(axis=1)]
        volumes = [
            ConvexHull(np.concatenate([seeds[k], points[np.unique(corner[owner == k])]])).volume for k in kept
        ]
        sound = np.array([v < MOST_GROWTH * hulls[k].volume for k, v in zip(kept, volumes, strict=True)])
        if sound.all() or not sound.any():
            break
        kept = kept[sound]
    rng = np.random.default_rng(1)
    pieces = []
    for k in kept:
        inner = np.concatenate(
            [seeds[k], rng.dirichlet(np.full(len(seeds[k]), 0.3), INNER_SAMPLES) @ seeds[k]]
        )
        inner = inner[reach.of(inner, sure=True)[0] == 0.0]
        triangles = points[corner[owner == k]]
        if len(triangles) or len(inner) > 3:
            pieces.append(piece_of(triangles, inner, reach))
    return pieces


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


def _beyond(hulls: tuple[trimesh.Trimesh, ...], reach: Reach) -> Array:
    """Of points on the pieces that no other piece covers, how far beyond the surface [m]."""
    planes = [ConvexHull(np.asarray(hull.vertices)).equations for hull in hulls]
    boxes = np.stack([np.asarray(hull.bounds) for hull in hulls])
    areas = np.array([hull.area for hull in hulls])
    found = []
    for k, hull in enumerate(hulls):
        count = max(20, round(SAMPLES * areas[k] / areas.sum()))
        points = np.asarray(trimesh.sample.sample_surface(hull, count, seed=0)[0])
        covered = np.zeros(len(points), dtype=bool)
        meets = (boxes[:, 0] <= boxes[k, 1]).all(axis=1) & (boxes[:, 1] >= boxes[k, 0]).all(axis=1)
        for other in np.flatnonzero(meets):
            if other != k:
                covered |= outside(points, planes[other]) < 0.0
        found.append(reach.of(points[~covered], sure=True)[0])
    return np.concatenate(found)
