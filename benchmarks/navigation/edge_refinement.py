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

from benchmarks.edges.tracking.edge_search import Levels, search
from polhode.camera import RectifiedRig
from polhode.lie import Array
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import edge_motion
from polhode.planning.edges.stripes import CAUCHY
from polhode.planning.edges.visible_edges import SPACING_PX, ControlPoints, control_points
from polhode.records import Bools, Ints

RANGES_PX = (4.0, 3.0, 2.0, 1.5)
"""searched on both sides, turn by turn"""
SIGMAS_PX = (1.5, 1.0, 0.6, 0.4)
"""of an edge's place in an image, turn by turn: errors of the poses, the light, and what is no edge"""
LEAST_CONTRAST = 4.0
"""[grey levels]"""
AGREES_PX = 0.8
LEAST_SHARE, LEAST_VIEWS = 0.5, 3
"""Of the control points of an edge that agree with the images, and of images that show it"""
MOST_SIGMA = 0.01
"""Sigma of an edge across it that is worth tracking, over the body's radius"""
_NEIGHBOURS = 6
"""Vertices of the mesh whose median sigma is that of an end"""


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
class Sight:
    """An image and the pose that the run has of it."""

    grey: Levels
    X_CG: Array
    """(4, 4)"""


def refined(
    model: EdgeModel, mesh: trimesh.Trimesh, sigma_m: Array, rig: RectifiedRig, sights: Sequence[Sight]
) -> RefinedEdges:
    """The segments that the images confirm. Outlines of smooth parts are left out: they slide.

    ``sigma_m`` (V,): of the mesh's vertices, inf where nothing was measured.
    """
    prior_m, axes = _sigma_of_ends(model, mesh, sigma_m), _across(model.ends_G)
    first, moved = model, np.zeros((len(model.ends_G), 4))
    if not sights:
        return RefinedEdges(model.only(np.zeros(0, dtype=np.int64)), np.zeros((0, 6, 6)))
    for range_px, sigma_px in zip(RANGES_PX, SIGMAS_PX, strict=True):
        every = [_measured(model, rig, sight, range_px) for sight in sights]
        moved = _solved(model, axes, prior_m, moved, every, sigma_px).moved
        model = _displaced(first, np.einsum("nij,nej->nei", axes, moved.reshape(-1, 2, 2)))
    every = [_measured(model, rig, sight, RANGES_PX[-1]) for sight in sights]
    return _confirmed(model, axes, _solved(model, axes, prior_m, moved, every, SIGMAS_PX[-1]), every)


def _displaced(model: EdgeModel, by_G: Array) -> EdgeModel:
    """The model with its ends moved (n, 2, 3); the directions of its edges turn with them."""
    ends = model.ends_G + by_G
    turn = _directions(ends) - _directions(model.ends_G)
    tangents = model.tangents_G + turn[:, None]
    tangents /= np.maximum(np.linalg.norm(tangents, axis=2, keepdims=True), 1e-12)
    return replace(model, ends_G=ends, tangents_G=tangents)


def _directions(ends_G: Array) -> Array:
    """(n, 3) unit, from one end to the other."""
    along = ends_G[:, 1] - ends_G[:, 0]
    return np.asarray(along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12))


@dataclass(frozen=True)
class _Measured:
    """Control points of segments in one image."""

    points: ControlPoints
    f_G: Array
    """(m, 3) displacement across the edge in the image by one of the point in G [px/m]"""
    offset_px: Array
    """(m, k) candidates"""


def _measured(model: EdgeModel, rig: RectifiedRig, sight: Sight, range_px: float) -> _Measured:
    points = control_points(model, rig, sight.X_CG, SPACING_PX)
    points = points[points.feature < len(model.ends_G)]
    f = edge_motion(points, rig, sight.X_CG, model.centre_G)
    either = np.zeros(len(points), dtype=np.int64)
    found = search(sight.grey, points.uv_px, points.normal_px, either, range_px, LEAST_CONTRAST)
    return _Measured(points, f[:, :3] @ sight.X_CG[:3, :3], found.offset_px)


def _sigma_of_ends(model: EdgeModel, mesh: trimesh.Trimesh, sigma_m: Array) -> Array:
    """(n, 2) of the mesh and of its simplification [m]."""
    finite = sigma_m[np.isfinite(sigma_m)]
    largest = float(finite.max()) if len(finite) else model.tolerance_m
    _, near = cKDTree(mesh.vertices).query(model.ends_G.reshape(-1, 3), k=_NEIGHBOURS)
    sigma = np.median(np.minimum(sigma_m[near], largest), axis=1).reshape(-1, 2)
    return np.hypot(sigma, model.tolerance_m)


def _across(ends_G: Array) -> Array:
    """(n, 3, 2) two unit directions across each segment."""
    along = _directions(ends_G)
    least = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    one = np.cross(along, least)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    return np.stack([one, np.cross(along, one)], axis=2)


def _by_ends(points: ControlPoints, ends_G: Array) -> Array:
    a, b = np.moveaxis(ends_G[points.feature], 1, 0)
    along = b - a
    length = np.maximum(np.einsum("mk,mk->m", along, along), 1e-18)
    share = np.clip(np.einsum("mk,mk->m", points.p_G - a, along) / length, 0.0, 1.0)
    return np.asarray(
        np.concatenate([(1.0 - share)[:, None, None] * np.eye(3), share[:, None, None] * np.eye(3)], axis=2)
    )


@dataclass(frozen=True)
class _Solved:
    moved: Array
    """(n, 4) the ends, across the segment, from where the mesh has them"""
    prior: Array
    """(n, 4, 4) information of the mesh"""
    data: Array
    """(n, 4, 4) information of the images, as if their points were independent"""


_TURNS = 8


def _rows(model: EdgeModel, axes: Array, every: Sequence[_Measured]) -> tuple[Ints, Array, Array, Ints]:
    """Segments (m,), derivatives (m, 4) by the ends across them, candidates (m, k), and images (m,)."""
    segment = np.concatenate([each.points.feature for each in every])
    by_ends = np.concatenate(
        [np.einsum("mi,mij->mj", each.f_G, _by_ends(each.points, model.ends_G)) for each in every]
    ).reshape(-1, 2, 3)
    by_axes = np.einsum("mei,mij->mej", by_ends, axes[segment]).reshape(-1, 4)
    offset = np.concatenate([each.offset_px for each in every])
    image = np.concatenate([np.full(len(each.points), k) for k, each in enumerate(every)])
    return segment, by_axes, offset, image


def _nearest(offset_px: Array, at_px: Array) -> Array:
    """(m,) the candidate nearest to a place, less that place; NaN where there is none."""
    away = offset_px - at_px[:, None]
    which = np.argmin(np.where(np.isnan(away), np.inf, np.abs(away)), axis=1)
    return np.asarray(away[np.arange(len(away)), which])


def _solved(
    model: EdgeModel,
    axes: Array,
    prior_m: Array,
    moved: Array,
    every: Sequence[_Measured],
    sigma_px: float,
) -> _Solved:
    """Places of all segments, each by itself: least squares with Cauchy's weights.

    ``moved`` (n, 4): where the model has them, from where the mesh had them, about which the prior is.
    """
    n = len(model.ends_G)
    segment, J, offset, _ = _rows(model, axes, every)
    prior = np.zeros((n, 4, 4))
    prior[:, np.arange(4), np.arange(4)] = np.repeat(prior_m, 2, axis=1) ** -2.0
    place = moved
    for _ in range(_TURNS):
        at = np.einsum("mk,mk->m", J, (place - moved)[segment])
        left = _nearest(offset, at)
        seen = np.isfinite(left)
        weight = np.where(seen, 1.0 / (1.0 + (np.nan_to_num(left) / (CAUCHY * sigma_px)) ** 2), 0.0)
        weight /= sigma_px**2
        N, right = prior.copy(), np.zeros((n, 4))
        np.add.at(N, segment, weight[:, None, None] * J[:, :, None] * J[:, None, :])
        from_mesh = at + np.nan_to_num(left) + np.einsum("mk,mk->m", J, moved[segment])
        np.add.at(right, segment, (weight * from_mesh)[:, None] * J)
        place = np.linalg.solve(N, right[..., None])[..., 0]
    return _Solved(place, prior, N - prior)


def _confirmed(model: EdgeModel, axes: Array, told: _Solved, every: Sequence[_Measured]) -> RefinedEdges:
    """The segments that most of their control points agree with, in several images."""
    n = len(model.ends_G)
    segment, _, offset, image = _rows(model, axes, every)
    left = _nearest(offset, np.zeros(len(segment)))
    agrees = np.abs(np.nan_to_num(left, nan=np.inf)) < AGREES_PX
    of = np.bincount(segment, minlength=n)
    share = np.bincount(segment[agrees], minlength=n) / np.maximum(of, 1)
    views = np.array([len(np.unique(image[agrees & (segment == k)])) for k in range(n)])
    # residuals of one edge in one image are not independent: its images count, not its points
    points_a_view = of / np.maximum([len(np.unique(image[segment == k])) for k in range(n)], 1)
    C = np.linalg.inv(told.prior + told.data / np.maximum(points_a_view, 1.0)[:, None, None])
    A = np.zeros((n, 6, 4))
    A[:, :3, :2] = A[:, 3:, 2:] = axes
    ends = np.einsum("nij,njk,nlk->nil", A, C, A)
    sigma_m = np.sqrt(np.einsum("nii->n", C) / 4.0)
    kept: Bools = (share >= LEAST_SHARE) & (views >= LEAST_VIEWS) & (sigma_m < MOST_SIGMA * model.radius_m)
    return RefinedEdges(model.only(np.flatnonzero(kept)), ends[kept])
