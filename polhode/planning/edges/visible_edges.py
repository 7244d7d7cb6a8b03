"""Control points: the edges of a model that a camera sees from one pose, sampled every few pixels.

``control_points`` returns each line of the image once, ``every_point`` all edges that coincide there.

Smooth parts are seen by their outlines (occluding contours), where the surface turns away from the viewer:
the zero of N . (p - eye) with normals and positions interpolated over each face (Hertzmann and Zorin,
"Illustrating smooth surfaces", SIGGRAPH 2000). Under a small motion the outline slides over the surface, but
only along the line of sight, which the image does not show: its motion normal to the edge is that of the
material point (tests/planning/edges).
"""

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import cKDTree

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, transform_points
from polhode.planning.edges.edge_model import EdgeModel, unit_rows

SPACING_PX = 10.0
"""Spacing of control points along an edge."""
MERGED_PX, PARALLEL = 2.0, 0.97
"""Edges closer than this in the image, with this cosine of the angle between them, are merged."""
NEAR = 0.02
"""Near clipping plane, as a share of the body's radius."""


@dataclass(frozen=True)
class Outlines:
    """k short segments of outlines."""

    ends_G: Array
    """(k, 2, 3) [m]"""
    normals_G: Array
    """(k, 2, 3) unit, perpendicular to the line of sight"""
    part: Ints
    """(k,) smooth part"""
    bulge_m: Array
    """(k,) largest height of the smooth surface above the flat face"""


def outlines(model: EdgeModel, eye_G: Array) -> Outlines:
    """Outlines of the model's curved parts seen from eye_G (3,)."""
    return _of_facets(model, eye_G) if model.faceted else _of_smooth_surface(model, eye_G)


def _of_facets(model: EdgeModel, eye_G: Array) -> Outlines:
    """Edges between a face that points towards the eye and one that does not."""
    soft = model.soft[model.outlined_faces[model.soft[:, 2]]]
    face_normals = np.asarray(model.surface.face_normals)
    facing = np.einsum("fk,fk->f", face_normals, eye_G - np.asarray(model.surface.triangles)[:, 0]) > 0.0
    soft = soft[facing[soft[:, 2]] != facing[soft[:, 3]]]
    ends = np.asarray(model.surface.vertices)[soft[:, :2]]
    across = unit_rows(np.cross((ends[:, 1] - ends[:, 0])[:, None, :], ends - eye_G))
    outward = face_normals[soft[:, 2:]].sum(axis=1)
    across *= np.where(np.einsum("nek,nk->n", across, outward) < 0.0, -1.0, 1.0)[:, None, None]
    return Outlines(ends, across, np.asarray(model.part[soft[:, 2]]), np.zeros(len(soft)))


def _of_smooth_surface(model: EdgeModel, eye_G: Array) -> Outlines:
    """Where N . (p - eye) vanishes on the faces with corners on both sides of the outline."""
    # along an edge of a face it is quadratic, with one root between ends of opposite sign, in its stable form
    faces = np.flatnonzero(model.outlined_faces)
    corners, normals = np.asarray(model.surface.triangles)[faces], model.corner_normals_G[faces]
    away = np.einsum("fck,fck->fc", normals, corners - eye_G) > 0.0
    count = away.sum(axis=1)
    crossed = (count == 1) | (count == 2)
    faces, corners, normals = faces[crossed], corners[crossed], normals[crossed]
    # the corner that is alone on its side: the outline crosses its two edges
    alone, row = np.argmax(away[crossed] == (count[crossed] == 1)[:, None], axis=1), np.arange(len(faces))
    ends, end_normals = np.empty((2, len(faces), 2, 3))
    for side in range(2):
        other = (alone + 1 + side) % 3
        a, normal = corners[row, alone], normals[row, alone]
        d, turn, from_eye = corners[row, other] - a, normals[row, other] - normal, a - eye_G
        two, zero = np.einsum("fk,fk->f", turn, d), np.einsum("fk,fk->f", normal, from_eye)
        one = np.einsum("fk,fk->f", turn, from_eye) + np.einsum("fk,fk->f", normal, d)
        root = np.sqrt(np.maximum(one**2 - 4.0 * two * zero, 0.0))
        q = -0.5 * (one + np.where(one >= 0.0, root, -root))
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = q / two, zero / q
        t = np.where((first >= 0.0) & (first <= 1.0), first, second)
        t = np.clip(np.nan_to_num(t, posinf=0.0, neginf=0.0), 0.0, 1.0)[:, None]
        ends[:, side], end_normals[:, side] = a + t * d, normal + t * turn
    onward = corners - np.roll(corners, 1, axis=1), normals - np.roll(normals, 1, axis=1)
    bulge = np.abs(np.einsum("fck,fck->fc", *onward)).max(axis=1, initial=0.0) / 8.0
    return Outlines(ends, unit_rows(end_normals), model.part[faces], bulge)


@dataclass(frozen=True)
class ControlPoints:
    """m points on the visible edges of one view."""

    p_G: Array
    """(m, 3) [m]"""
    uv_px: Array
    """(m, 2) in the image"""
    normal_px: Array
    """(m, 2) unit, normal to the edge in the image"""
    feature: Ints
    """(m,) edge of the model: segments first, then smooth parts"""
    weight: Array
    """(m,) length of edge that the point represents, over the spacing"""
    sides_G: Array
    """(m, 2, 3) normals of the surface on both sides; an outline has its own twice"""

    def __len__(self) -> int:
        return len(self.feature)

    def __getitem__(self, which: Ints | Bools) -> "ControlPoints":
        # several times as fast as a mask on each of them
        rows = np.flatnonzero(which) if which.dtype == np.bool_ else which
        return ControlPoints(*(getattr(self, item.name).take(rows, axis=0) for item in fields(self)))


def control_points(
    model: EdgeModel, rig: RectifiedRig, X_RG: Array, spacing_px: float = SPACING_PX
) -> ControlPoints:
    """Edges of the model at X_RG (4, 4) that the rectified left camera sees, within its image.

    Of edges that coincide there, the longest. None from inside the body.
    """
    points = every_point(model, rig, X_RG, spacing_px)
    reach_px = 0.75 * spacing_px
    pairs = cKDTree(points.uv_px).query_pairs(np.hypot(MERGED_PX, reach_px), output_type="ndarray")
    a, b = pairs[points.feature[pairs[:, 0]] != points.feature[pairs[:, 1]]].T
    gap, normal = points.uv_px[b] - points.uv_px[a], points.normal_px
    across = np.abs(np.einsum("pk,pk->p", gap, normal[a]))
    along = np.sqrt(np.maximum(np.einsum("pk,pk->p", gap, gap) - across**2, 0.0))
    cosine = np.abs(np.einsum("pk,pk->p", normal[a], normal[b]))
    same = (across < MERGED_PX) & (along < reach_px) & (cosine > PARALLEL)
    a, b = a[same], b[same]
    length = np.bincount(points.feature, points.weight)[points.feature]
    b_goes = (length[a] > length[b]) | ((length[a] == length[b]) & (points.feature[a] < points.feature[b]))
    keep = np.ones(len(points), dtype=bool)
    keep[np.where(b_goes, b, a)] = False
    return points[keep]


def every_point(model: EdgeModel, rig: RectifiedRig, X_RG: Array, spacing_px: float) -> ControlPoints:
    """The same, with all edges that coincide in the image."""
    eye_G, n = inverse_pose(X_RG)[:3, 3], len(model.ends_G)
    if model.encloses(eye_G):
        none, ends = np.zeros((0, 3)), np.zeros((0, 2))
        return ControlPoints(none, ends, ends, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 2, 3)))
    near_m = NEAR * model.radius_m

    # segments: points at the centres of equal steps of each of them
    piece, share, length_px = _steps(model.ends_G, X_RG, rig, spacing_px, near_m)
    p_G, tangent_G = _between(model.ends_G, piece, share), _between(model.tangents_G, piece, share)
    uv, normal, free = _in_image(p_G, np.cross(p_G - eye_G, tangent_G), X_RG, rig)
    free &= ~model.occluder.hides(eye_G, p_G + model.lift_G[piece], 2.0 * model.tolerance_m)
    segments = ControlPoints(p_G, uv, normal, piece, length_px / spacing_px, model.sides_G[piece])[free]

    # outlines: their pieces are shorter than a step, so points are at equal steps along all of them
    contours = outlines(model, eye_G)
    piece, share, length_px = _steps(contours.ends_G, X_RG, rig, spacing_px, near_m)
    reached = np.cumsum(length_px) / spacing_px + 0.5
    full = np.floor(reached) > np.floor(reached - length_px / spacing_px)
    piece, share = piece[full], share[full]
    p_G, normal_G = _between(contours.ends_G, piece, share), _between(contours.normals_G, piece, share)
    normal_G = unit_rows(normal_G)
    uv, normal, free = _in_image(p_G, normal_G, X_RG, rig)
    lift_m = model.tolerance_m + 2.0 * contours.bulge_m[piece]
    free &= ~model.occluder.hides(eye_G, p_G + lift_m[:, None] * normal_G, 2.0 * model.tolerance_m)
    sides = np.stack([normal_G, normal_G], axis=1)
    smooth = ControlPoints(p_G, uv, normal, n + contours.part[piece], np.ones(len(piece)), sides)[free]
    return ControlPoints(
        *(
            np.concatenate([getattr(each, item.name) for each in (segments, smooth)])
            for item in fields(smooth)
        )
    )


def _steps(
    ends_G: Array, X_RG: Array, rig: RectifiedRig, spacing_px: float, near_m: float
) -> tuple[Ints, Array, Array]:
    """Equal steps in the image of segments within the field of view (clipped as by Liang and Barsky, 1984).

    The segment (m,) of each step, the fraction (m,) in space along it of its centre, its length (m,) [px].
    """
    ends_R = transform_points(X_RG, ends_G.reshape(-1, 3)).reshape(-1, 2, 3)
    z0, z1 = ends_R[:, 0, 2], ends_R[:, 1, 2]
    at = (near_m - z0) / np.where(np.abs(z1 - z0) > 1e-12, z1 - z0, 1.0)
    start = np.where(z0 >= near_m, 0.0, np.where(z1 < near_m, 1.0, at))
    end = np.where(z1 >= near_m, 1.0, np.where(z0 < near_m, 0.0, at))
    ahead = np.flatnonzero(end > start)
    start, end, ends_R = start[ahead], end[ahead], ends_R[ahead]
    a_R, b_R = (ends_R[:, 0] + t[:, None] * (ends_R[:, 1] - ends_R[:, 0]) for t in (start, end))
    a, b = (rig.project(each)[:, :2] for each in (a_R, b_R))
    enter, leave = np.zeros(len(a)), np.ones(len(a))
    for axis, end_px in enumerate((rig.width_px - 0.5, rig.height_px - 0.5)):
        for sign, bound in ((-1.0, -0.5), (1.0, end_px)):
            gap, slope = sign * (bound - a[:, axis]), sign * (b[:, axis] - a[:, axis])
            t = gap / np.where(slope == 0.0, 1.0, slope)
            enter = np.where(slope < 0.0, np.maximum(enter, t), enter)
            leave = np.where(slope > 0.0, np.minimum(leave, t), leave)
            leave = np.where((slope == 0.0) & (gap < 0.0), 0.0, leave)
    length_px = np.hypot(*(b - a).T) * np.maximum(leave - enter, 0.0)
    count = np.ceil(length_px / spacing_px).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    in_step = (np.arange(len(row)) - (np.cumsum(count) - count)[row] + 0.5) / count[row]
    in_image = enter[row] + in_step * (leave - enter)[row]
    # 1 / z is linear along the image of a segment
    za, zb = a_R[row, 2], b_R[row, 2]
    in_space = in_image / zb / ((1.0 - in_image) / za + in_image / zb)
    return ahead[row], start[row] + in_space * (end - start)[row], (length_px / np.maximum(count, 1))[row]


def _between(ends: Array, piece: Ints, share: Array) -> Array:
    """Points (m, 3) at fractions (m,) of the segments ``piece`` (m,) of (n, 2, 3)."""
    start = ends[piece, 0]
    return np.asarray(start + share[:, None] * (ends[piece, 1] - start))


def _in_image(p_G: Array, plane_G: Array, X_RG: Array, rig: RectifiedRig) -> tuple[Array, Array, Bools]:
    """Places (m, 2) of points [px], unit normals (m, 2) of planes through them and the eye, if any (m,)."""
    uv = rig.project(transform_points(X_RG, p_G))[:, :2]
    plane_R = plane_G @ X_RG[:3, :3].T
    length = np.hypot(plane_R[:, 0], plane_R[:, 1])
    well = length > 1e-9 * np.maximum(np.hypot(length, plane_R[:, 2]), 1e-300)
    return uv, plane_R[:, :2] / np.where(well, length, 1.0)[:, None], np.asarray(well)


def why_no_edge(model: EdgeModel, rig: RectifiedRig, X_RG: Array) -> str:
    """Description of the reason why a view at X_RG (4, 4) shows no edge."""
    if model.encloses(inverse_pose(X_RG)[:3, 3]):
        return "the camera is inside the body"
    vertices_R = transform_points(X_RG, np.asarray(model.surface.vertices))
    ahead = vertices_R[vertices_R[:, 2] > NEAR * model.radius_m]
    if len(ahead) == 0:
        return "the body is behind the camera"
    u, v = rig.project(ahead)[:, :2].T
    if min(u.max(), v.max()) < -0.5 or u.min() > rig.width_px - 0.5 or v.min() > rig.height_px - 0.5:
        return "the body is outside the image"
    return "all edges are hidden or outside the image"
