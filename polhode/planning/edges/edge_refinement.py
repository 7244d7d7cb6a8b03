"""Edges of a run's mesh, moved to where the images of the inspection have them.

A mesh is made from depth, which is poor at edges: some are off by several times what an image resolves, and
others do not exist. The run knows the poses of its images, so that each edge is a straight line seen from
many places. Its two ends are moved across it by least squares over all images, with the mesh's sigma as
prior about the mesh's own place; turn by turn, of the extrema of the gradient across a control point, the one
nearest to the line counts, in a range that narrows. An edge that too few images show is left out. What
remains are edges of shape or of paint that turn with the body; borders of shadows do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints
from polhode.planning.edges.edge_model import EdgeModel, unit_rows
from polhode.planning.edges.image_profiles import Levels, gradient_extrema
from polhode.planning.edges.observability_metric import edge_motion
from polhode.planning.edges.stripes import CAUCHY
from polhode.planning.edges.visible_edges import SPACING_PX, ControlPoints, control_points

RANGES_PX = (4.0, 3.0, 2.0, 1.5)
"""Searched on both sides, turn by turn"""
SIGMAS_PX = (1.5, 1.0, 0.6, 0.4)
"""Of an edge's place in an image, turn by turn: errors of the poses, the light, and what is no edge"""
MIN_CONTRAST = 4.0
"""[grey levels]"""
AGREEMENT_PX = 0.8
"""An image agrees with a control point whose nearest edge is this near"""
MIN_AGREEING_SHARE, MIN_VIEWS = 0.5, 3
"""Of the control points of an edge that agree with the images, and of images that show it"""
MAX_SIGMA = 0.01
"""Sigma of an edge across it that is worth tracking, over the body's radius"""
NEIGHBOURS = 6
"""Vertices of the mesh whose median sigma is that of an end"""
REWEIGHTINGS = 8


@dataclass(frozen=True)
class RefinedEdges:
    """A model of n segments, and how well the places of their ends are known."""

    model: EdgeModel
    covariance: Array
    """(n, 6, 6) of both ends in G [m^2]; along the edge they are exact, as nothing depends on it"""

    @property
    def sigma_m(self) -> Array:
        """(n,) of a place on each segment, across it, root mean square of the directions."""
        return np.asarray(np.sqrt(np.einsum("nii->n", self.covariance) / 4.0))

    def at(self, points: ControlPoints) -> Array:
        """Derivative (m, 3, 6) of points of segments by the ends of theirs."""
        return _by_ends(points, self.model.ends_G)


@dataclass(frozen=True)
class PosedImage:
    """An image and the pose that the run has of it."""

    grey: Levels
    X_CG: Array
    """(4, 4)"""


def refined_edges(
    model: EdgeModel,
    mesh: trimesh.Trimesh,
    sigma_m: Array,
    rig: RectifiedRig,
    images: Sequence[PosedImage],
) -> RefinedEdges:
    """The segments that the images confirm. Outlines of smooth parts are left out: they slide.

    ``sigma_m`` (V,): of the mesh's vertices, inf where nothing was measured.
    """
    if not images:
        return RefinedEdges(model.only(np.zeros(0, dtype=np.int64)), np.zeros((0, 6, 6)))
    start, n = model, len(model.ends_G)
    # two unit directions across each segment (n, 3, 2), along which its ends move
    along = unit_rows(model.ends_G[:, 1] - model.ends_G[:, 0])
    one = unit_rows(np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)]))
    axes = np.stack([one, np.cross(along, one)], axis=2)
    # the prior is that of the mesh and of its simplification
    finite = sigma_m[np.isfinite(sigma_m)]
    largest = float(finite.max()) if len(finite) else model.tolerance_m
    _, near = cKDTree(mesh.vertices).query(model.ends_G.reshape(-1, 3), k=NEIGHBOURS)
    sigma = np.hypot(np.median(np.minimum(sigma_m[near], largest), axis=1).reshape(-1, 2), model.tolerance_m)
    prior = np.repeat(sigma, 2, axis=1)[:, :, None] ** -2.0 * np.eye(4)
    moved = np.zeros((n, 4))
    for range_px, sigma_px in zip(RANGES_PX, SIGMAS_PX, strict=True):
        moved, _ = _solve(_rows(model, axes, rig, images, range_px), prior, moved, sigma_px)
        ends = start.ends_G + np.einsum("nij,nej->nei", axes, moved.reshape(-1, 2, 2))
        turn = unit_rows(ends[:, 1] - ends[:, 0]) - along
        model = replace(start, ends_G=ends, tangents_G=unit_rows(start.tangents_G + turn[:, None]))

    rows = _rows(model, axes, rig, images, RANGES_PX[-1])
    _, information = _solve(rows, prior, moved, SIGMAS_PX[-1])
    segment = rows.segment
    agrees = np.abs(np.nan_to_num(rows.nearest(np.zeros(len(segment))), nan=np.inf)) < AGREEMENT_PX
    points = np.bincount(segment, minlength=n)
    share = np.bincount(segment[agrees], minlength=n) / np.maximum(points, 1)
    views, agreeing_views = (
        np.bincount(np.unique(np.column_stack(pair), axis=0)[:, 0], minlength=n)
        for pair in ((segment, rows.image), (segment[agrees], rows.image[agrees]))
    )
    # residuals of one edge in one image are not independent: its images count, not its points
    points_per_view = np.maximum(points / np.maximum(views, 1), 1.0)
    C = np.linalg.inv(prior + information / points_per_view[:, None, None])
    A = np.zeros((n, 6, 4))
    A[:, :3, :2] = A[:, 3:, 2:] = axes
    across_m = np.sqrt(np.einsum("nii->n", C) / 4.0)
    confirmed = (share >= MIN_AGREEING_SHARE) & (agreeing_views >= MIN_VIEWS)
    confirmed &= across_m < MAX_SIGMA * model.radius_m
    covariance = np.einsum("nij,njk,nlk->nil", A, C, A)
    return RefinedEdges(model.only(np.flatnonzero(confirmed)), covariance[confirmed])


@dataclass(frozen=True)
class _Rows:
    """Control points (m) of segments in all images."""

    segment: Ints
    """(m,)"""
    image: Ints
    """(m,)"""
    by_ends: Array
    """(m, 4) displacement across the edge in the image by those of the two ends across the segment [px/m]"""
    candidates_px: Array
    """(m, k) edges of the image"""

    def nearest(self, at_px: Array) -> Array:
        """(m,) the candidate nearest to a place, less that place; NaN where there is none."""
        away = self.candidates_px - at_px[:, None]
        which = np.argmin(np.where(np.isnan(away), np.inf, np.abs(away)), axis=1)
        return np.asarray(away[np.arange(len(away)), which])


def _rows(
    model: EdgeModel, axes: Array, rig: RectifiedRig, images: Sequence[PosedImage], range_px: float
) -> _Rows:
    parts = []
    for number, image in enumerate(images):
        points = control_points(model, rig, image.X_CG, SPACING_PX)
        points = points[points.feature < len(model.ends_G)]
        f_G = edge_motion(points, rig, image.X_CG, model.centre_G)[:, :3] @ image.X_CG[:3, :3]
        by_ends = np.einsum("mi,mij->mj", f_G, _by_ends(points, model.ends_G)).reshape(-1, 2, 3)
        across = np.einsum("mei,mij->mej", by_ends, axes[points.feature]).reshape(-1, 4)
        candidates = gradient_extrema(image.grey, points, range_px, MIN_CONTRAST)
        parts.append((points.feature, np.full(len(points), number), across, candidates))
    return _Rows(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _solve(rows: _Rows, prior: Array, moved: Array, sigma_px: float) -> tuple[Array, Array]:
    """Places (n, 4) of all segments, each by itself, and the images' information (n, 4, 4).

    Least squares with Cauchy's weights. ``moved`` (n, 4): where the model has the ends, across the segments,
    from where the mesh has them, about which the prior is.
    """
    J, segment, place = rows.by_ends, rows.segment, moved
    N = prior
    for _ in range(REWEIGHTINGS):
        at = np.einsum("mk,mk->m", J, (place - moved)[segment])
        left = rows.nearest(at)
        robust = 1.0 / (1.0 + (np.nan_to_num(left) / (CAUCHY * sigma_px)) ** 2)
        weight = np.asarray(np.where(np.isfinite(left), robust, 0.0) / sigma_px**2)
        N = prior.copy()
        right = np.zeros_like(moved)
        np.add.at(N, segment, weight[:, None, None] * J[:, :, None] * J[:, None, :])
        from_mesh = at + np.nan_to_num(left) + np.einsum("mk,mk->m", J, moved[segment])
        np.add.at(right, segment, (weight * from_mesh)[:, None] * J)
        place = np.asarray(np.linalg.solve(N, right[..., None])[..., 0], dtype=np.float64)
    return place, N - prior


def _by_ends(points: ControlPoints, ends_G: Array) -> Array:
    """Derivative (m, 3, 6) of points of segments by the ends of theirs."""
    a, b = np.moveaxis(ends_G[points.feature], 1, 0)
    along = b - a
    length = np.maximum(np.einsum("mk,mk->m", along, along), 1e-18)
    share = np.clip(np.einsum("mk,mk->m", points.p_G - a, along) / length, 0.0, 1.0)[:, None, None]
    return np.concatenate([(1.0 - share) * np.eye(3), share * np.eye(3)], axis=2)
