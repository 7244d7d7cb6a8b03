"""A convex body that contains the target, as half-spaces, and points that fill it evenly.

It is the convex hull of the surface and of the landmarks, moved outwards by three standard deviations of the
surface, and extended where a part was never seen.

The extension follows from a sphere that is seen to a depth h, up to a circle of radius r: the cap behind the
disc that closes the seen part is r^2 / h high, and the disc is the share of the hull's area that was not
seen. Bodies are seen from the side, too, so less of their depth is missing: over the ten scenes of
configs/scenes in which a part was not seen, at most 0.30 of that height. A third is added.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.stats import qmc

from polhode.geometry.lie import Array
from polhode.records.estimate import Landmarks
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Coverage

SHARE_OF_CAP = 1.0 / 3.0
MAX_EXTENSION = 0.5
"""Of the body's smaller width across, or of its depth where that is larger: a body of which one side was seen
is taken to be no deeper."""
DRAWN_POINTS = 16384
"""Points drawn in the box around the hull, of which those inside are kept."""


@dataclass(frozen=True)
class BodyHull:
    """Points x of G with ``normals @ x <= offsets``."""

    normals: Array
    """(H, 3) unit, outwards"""
    offsets: Array
    """(H,) [m]"""
    vertices: Array
    """(V, 3) [m]"""

    @property
    def middle(self) -> Array:
        """(3,) the middle of the box around the hull [m]."""
        return np.asarray(0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0)))

    @property
    def radius_m(self) -> float:
        """Distance from the middle to the farthest vertex [m]."""
        return float(np.linalg.norm(self.vertices - self.middle, axis=1).max())

    def within(self, low: Array, high: Array) -> "BodyHull":
        """The part between the coordinates low and high (3,) [m]; its vertices stay those of the whole."""
        return BodyHull(
            np.concatenate([self.normals, np.eye(3), -np.eye(3)]),
            np.concatenate([self.offsets, high, -low]),
            self.vertices,
        )

    def points(self, count: int) -> Array:
        """(count, 3) or fewer points [m], spread evenly over the volume; always the same."""
        middle = self.vertices.mean(axis=0)
        axes = np.linalg.svd(self.vertices - middle, full_matrices=False)[2]
        along = (self.vertices - middle) @ axes.T
        low, high = along.min(axis=0), along.max(axis=0)
        drawn = middle + (low + (high - low) * qmc.Sobol(3, seed=0).random(DRAWN_POINTS)) @ axes
        inside = (drawn @ self.normals.T <= self.offsets).all(axis=1)
        return np.asarray(drawn[inside][:count])


def body_hull(
    surface: SurfaceModel, landmarks: Landmarks | None, coverage: Coverage | None
) -> BodyHull | None:
    """The hull of a run's target; None where there are too few points, or all lie in a plane."""
    points = np.asarray(surface.mesh.vertices, dtype=np.float64)
    sigma_m = surface.sigma_m[np.isfinite(surface.sigma_m)]
    if landmarks is not None:
        points = np.concatenate([points, landmarks.p_G[landmarks.observations >= 3]])
    growth_m = 3.0 * float(np.median(sigma_m)) if len(sigma_m) else 0.0
    unseen, direction = 0.0, None
    if coverage is not None:
        unseen = coverage.unseen
        direction = None if coverage.unseen_direction_G is None else np.array(coverage.unseen_direction_G)
    return hull_around(points, growth_m, unseen, direction)


def hull_around(
    points: Array, growth_m: float = 0.0, unseen: float = 0.0, direction_G: Array | None = None
) -> BodyHull | None:
    """The hull of points (n, 3) [m], grown by ``growth_m`` and by what was not seen.

    ``unseen``: share of the hull's area; ``direction_G`` (3,): the unit vector that this part faces, None: it
    faces all around. None where there are too few points, or all lie in a plane.
    """
    try:
        seen = ConvexHull(points)
        corners = points[seen.vertices]
        if unseen > 0.0:
            corners = _extend_corners(corners, unseen * float(seen.area), direction_G)
        hull = ConvexHull(corners)
    except (QhullError, ValueError):
        return None
    corners = hull.points[hull.vertices]
    # coplanar triangles of a facet have the same half-space
    rows = np.unique(np.round(hull.equations, 12), axis=0)
    middle = corners.mean(axis=0)
    outwards = corners - middle
    outwards = outwards / np.linalg.norm(outwards, axis=1, keepdims=True)
    return BodyHull(rows[:, :3], growth_m - rows[:, 3], corners + growth_m * outwards)


def _extend_corners(corners: Array, area_m2: float, direction_G: Array | None) -> Array:
    """Corners of the hull, extended behind a part of that area which was not seen."""
    cap = SHARE_OF_CAP * area_m2 / np.pi
    if direction_G is None:
        # all around: half of it on either side
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        width = float(np.ptp(corners, axis=0).min())
        return np.asarray(middle + (1.0 + min(cap / width**2, MAX_EXTENSION)) * (corners - middle))
    depth = float(np.ptp(corners @ direction_G))
    across = corners - corners.mean(axis=0)
    across = across - np.outer(across @ direction_G, direction_G)
    narrow = float(np.ptp(across @ np.linalg.svd(across, full_matrices=False)[2][1]))
    length = min(cap / max(depth, 1e-12), MAX_EXTENSION * max(depth, narrow))
    return np.concatenate([corners, corners + length * direction_G])
