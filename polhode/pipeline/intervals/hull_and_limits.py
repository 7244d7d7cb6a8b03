"""A convex body that contains the target, and what the motion determines of its centre of mass and inertia.

The body is the convex hull of the surface and of the landmarks, moved outwards by three standard deviations
of the surface, and extended where a part was never seen. The extension follows from a sphere that is seen to
a depth h, up to a circle of radius r: the cap behind the disc that closes the seen part is r^2 / h high, and
the disc is the share of the hull's area that was not seen. Bodies are seen from the side, too, so less of
their depth is missing: over the ten scenes of configs/scenes in which a part was not seen, at most 0.30 of
that height. A third is added.

The centre of mass of any mass that is nowhere negative lies in the hull. Where the motion determines all but
a shift along the axis of rotation, what remains is the piece of that axis inside the hull, whose ends linear
programs find. The limits of the inertia are linear in J, not in the solver's parameters: Euler's equations
are linear in J, so what a motion leaves free is a cone of J. A steady spin about u, for example, demands that
u is a principal axis, which is two linear equations, however far the other moments are from the estimate.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, QhullError

from polhode.geometry.lie import Array
from polhode.records.estimate import Landmarks
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Coverage

MAX_EXTENSION = 0.5
"""Of the body's smaller width across, or of its depth where that is larger: a body of which one side was seen
is taken to be no deeper."""
SIGMAS = 5.0
"""A determined combination of components lies within that many of its standard deviations."""
LINEAR_BELOW = 0.06
"""A standard deviation of the solver's parameters, which are logarithms: above it, where the estimate may be
far from linear, the limit is twice as wide. It is the one from which on k1 and k2 count as undetermined."""
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the six components of a symmetric matrix."""


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
        normals = np.concatenate([self.normals, np.eye(3), -np.eye(3)])
        return BodyHull(normals, np.concatenate([self.offsets, high, -low]), self.vertices)

    def points(self, count: int) -> Array:
        """(count, 3) or fewer points [m], spread evenly over the volume; always the same."""
        from scipy.stats import qmc  # half a second, which most runs need not

        middle = self.vertices.mean(axis=0)
        axes = np.linalg.svd(self.vertices - middle, full_matrices=False)[2]
        along = (self.vertices - middle) @ axes.T
        low, high = along.min(axis=0), along.max(axis=0)
        # in the box around the hull, of which those inside are kept
        drawn = middle + (low + (high - low) * qmc.Sobol(3, seed=0).random(16384)) @ axes
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
    outwards = corners - corners.mean(axis=0)
    outwards = outwards / np.linalg.norm(outwards, axis=1, keepdims=True)
    return BodyHull(rows[:, :3], growth_m - rows[:, 3], corners + growth_m * outwards)


def _extend_corners(corners: Array, area_m2: float, direction_G: Array | None) -> Array:
    """Corners of the hull, extended behind a part of that area which was not seen."""
    cap = 1.0 / 3.0 * area_m2 / np.pi
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


@dataclass(frozen=True)
class MotionLimits:
    """``|com_axes^T (com_G - center_G)| <= com_margin_m`` and ``inertia_rows @ J <= 0``, J any scale."""

    center_G: Array
    """(3,) the estimate [m]"""
    com_axes: Array
    """(3, 3) orthonormal columns"""
    com_margin_m: Array
    """(3,)"""
    inertia_rows: Array
    """(m, 6) of J by PAIRS"""
    R_GP: Array
    """(3, 3) the estimated axes"""


def motion_limits(
    com_G: Array, R_GP: Array, J_G: Array, J_jacobian: Array, covariance: Array, w_G: Array, reach_m: float
) -> MotionLimits:
    """The limits of an estimate.

    J_G (3, 3) in the scale of the solver's parameters, J_jacobian (5, 3, 3) its derivative by them.
    covariance (20, 20) of the last state: ``MotionEstimate.covariance_last_body``; w_G (3,) [rad/s].
    reach_m: how far from the estimate the centre of mass can be.
    """
    variance, axes = np.linalg.eigh(covariance[17:20, 17:20])
    sigma_m = np.sqrt(np.maximum(variance, 0.0))
    # A shift that is free is one along the axis of rotation, whose own direction has a standard deviation.
    rate = float(np.linalg.norm(w_G))
    tilt = float(np.sqrt(np.linalg.eigvalsh(covariance[9:12, 9:12])[-1])) / max(rate, 1e-12)
    margin = SIGMAS * (sigma_m + min(tilt, 1.0) * min(reach_m, SIGMAS * float(sigma_m.max())))
    # J / s = J_G + sum of y_n dJ/dxi_n, the y bounded along the eigenvectors of their covariance; the scale s
    # and s y are linear in J
    basis = np.stack([[each[pair] for pair in PAIRS] for each in (*J_jacobian, J_G)], axis=1)
    of_J = np.linalg.inv(basis)
    variance, vectors = np.linalg.eigh(covariance[12:17, 12:17])
    change, scale = vectors.T @ of_J[:5], of_J[5]
    sigma = np.sqrt(np.maximum(variance, 0.0))
    bound = (SIGMAS * np.where(sigma < LINEAR_BELOW, 1.0, 2.0) * sigma)[:, None] * scale
    return MotionLimits(com_G, axes, margin, np.concatenate([change - bound, -change - bound]), R_GP)


def farthest_com(hull: BodyHull, limits: MotionLimits, direction_G: Array) -> Array | None:
    """The admitted centre of mass (3,) that is farthest along a direction (3,) of G; None: there is none."""
    axes = limits.com_axes
    offset = axes.T @ limits.center_G
    found = linprog(
        -direction_G,
        A_ub=np.concatenate([hull.normals, axes.T, -axes.T]),
        b_ub=np.concatenate([hull.offsets, offset + limits.com_margin_m, limits.com_margin_m - offset]),
        bounds=(None, None),
        method="highs",
    )
    return np.asarray(found.x) if found.status == 0 else None


def com_extremes(hull: BodyHull, limits: MotionLimits, directions_G: Array) -> Array | None:
    """Admitted centres of mass (n, 2, 3) [m] that are farthest back and forth along directions (n, 3)."""
    found = [farthest_com(hull, limits, sign * each) for each in directions_G for sign in (-1.0, 1.0)]
    known = [each for each in found if each is not None]
    return np.reshape(known, (-1, 2, 3)) if len(known) == len(found) else None
