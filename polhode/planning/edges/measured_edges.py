"""Edges of a run's mesh: of the mesh as it is, and moved to where the images of the inspection have them.

Marching cubes divides a surface into small faces whose angles are noise; quadric simplification (Garland and
Heckbert, SIGGRAPH 1997) first merges them where the surface is flat.

A mesh is made from depth, which is poor at edges: some are off by several times what an image resolves, and
others do not exist. The run knows the poses of its images, so that each edge is a straight line seen from
many places. Its two ends are moved across it by least squares over all images, with the mesh's sigma as
prior about the mesh's own place; turn by turn, of the extrema of the gradient across a control point, the one
nearest to the line counts, in a range that narrows. An edge that too few images show is left out. What
remains are edges of shape or of paint that turn with the body; borders of shadows do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import fast_simplification
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints
from polhode.planning.edges.edge_model import EdgeModel, edge_model, unit_rows
from polhode.planning.edges.observability_metric import edge_motion
from polhode.planning.edges.profiles import Levels, gradient_extrema
from polhode.planning.edges.stripes import CAUCHY
from polhode.planning.edges.visible_edges import ControlPoints, control_points

RANGES_PX = (4.0, 3.0, 2.0, 1.5)
"""Searched on both sides, turn by turn"""
SIGMAS_PX = (1.5, 1.0, 0.6, 0.4)
"""Of an edge's place in an image, turn by turn: errors of the poses, the light, and what is no edge"""


def measured_edge_model(mesh: trimesh.Trimesh, sigma_m: Array) -> EdgeModel:
    """Edges of a run's mesh in G, whose vertices have sigma_m (V,), inf where nothing was measured."""
    diameter = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    known = sigma_m[np.isfinite(sigma_m)]
    noise = 2.0 * float(np.median(known)) if len(known) else 0.0
    tolerance_m = max(2e-3 * diameter, noise)
    return edge_model(
        simplified(mesh, tolerance_m),
        tolerance_m=tolerance_m,
        min_length_m=0.025 * diameter,
        # the normals of a measured plane deviate by less from their mean
        flat_deg=20.0,
        faceted=True,
    )


def simplified(mesh: trimesh.Trimesh, tolerance_m: float, min_faces: int = 60) -> trimesh.Trimesh:
    """The coarsest simplification that agrees with the mesh: 95 % of either within the tolerance.

    The mesh itself where no simplification does.
    """
    best, faces = mesh, 0.6 * len(mesh.faces)
    if len(mesh.faces) <= min_faces:
        return best
    points, normals = _samples(mesh)
    tree = cKDTree(points)
    while faces >= min_faces:
        vertices, triangles = fast_simplification.simplify(
            np.asarray(best.vertices, dtype=np.float32),
            np.asarray(best.faces, dtype=np.int32),
            target_count=int(faces),
            agg=3,
        )
        # below what quadric simplification can reach, it returns the mesh nearly unchanged
        if len(triangles) == 0 or len(triangles) > 0.98 * len(best.faces):
            break
        tried = trimesh.Trimesh(vertices, triangles, process=False)
        own, own_normals = _samples(tried)
        there, back = _distance(tree, points, normals, own), _distance(cKDTree(own), own, own_normals, points)
        if min((there <= tolerance_m).mean(), (back <= tolerance_m).mean()) < 0.95:
            break
        best, faces = tried, 0.6 * faces
    return best


def _samples(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Points (n, 3) sampled on the surface, the normals of their faces (n, 3); deterministic."""
    points, face = trimesh.sample.sample_surface(mesh, 20_000, seed=0)
    return np.asarray(points), np.asarray(mesh.face_normals)[face]


def _distance(tree: cKDTree, points: Array, normals: Array, other: Array) -> Array:
    """Distance (m,) of points from the plane of the nearest sample, beyond a boundary from the sample."""
    distance, nearest = tree.query(other, k=4)
    gap = other[:, None] - points[nearest]
    across = np.abs(np.einsum("mkc,mkc->mk", gap, normals[nearest]))
    # Close to samples the distance to the plane counts; far from them there is no surface.
    spacing = 3.0 * float(np.median(distance[:, 0])) + 1e-12
    return np.asarray(np.where(distance[:, 0] < spacing, across.min(axis=1), distance[:, 0]))


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


@dataclass(frozen=True)
class PosedImage:
    """An image and the pose that the run has of it."""

    grey: Levels
    X_CG: Array
    """(4, 4)"""


def refined_edges(
    model: EdgeModel, mesh: trimesh.Trimesh, sigma_m: Array, rig: RectifiedRig, images: Sequence[PosedImage]
) -> RefinedEdges:
    """The segments that the images confirm. Outlines of smooth parts are left out: they slide.

    ``sigma_m`` (V,): of the mesh's vertices, inf where nothing was measured. An edge is confirmed by three
    images at least, where half of its control points lie within 0.8 px of an edge, if its sigma is then below
    1 % of the body's radius.
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
    _, near = cKDTree(mesh.vertices).query(model.ends_G.reshape(-1, 3), k=6)
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
    agrees = np.abs(np.nan_to_num(rows.nearest(np.zeros(len(segment))), nan=np.inf)) < 0.8
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
    confirmed = (share >= 0.5) & (agreeing_views >= 3)
    confirmed &= across_m < 0.01 * model.radius_m
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
        points = control_points(model, rig, image.X_CG)
        points = points[points.feature < len(model.ends_G)]
        f_G = edge_motion(points, rig, image.X_CG, model.centre_G)[:, :3] @ image.X_CG[:3, :3]
        by_ends = np.einsum("mi,mij->mj", f_G, _by_ends(points, model.ends_G)).reshape(-1, 2, 3)
        across = np.einsum("mei,mij->mej", by_ends, axes[points.feature]).reshape(-1, 4)
        candidates = gradient_extrema(image.grey, points, range_px, min_contrast=4.0)
        parts.append((points.feature, np.full(len(points), number), across, candidates))
    return _Rows(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _solve(rows: _Rows, prior: Array, moved: Array, sigma_px: float) -> tuple[Array, Array]:
    """Places (n, 4) of all segments by Cauchy's weights, and the images' information (n, 4, 4).

    ``moved`` (n, 4): the ends of the model, across the segments, from the mesh's, about which the prior is.
    """
    J, segment, place = rows.by_ends, rows.segment, moved
    N = prior
    for _ in range(8):
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
