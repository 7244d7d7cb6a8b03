"""Control points: the edges of a model that a camera sees from one pose, sampled every few pixels.

``control_points`` returns all of them, each line of the image once; ``clear_points`` only those separated
from other edges: of two adjacent parallel edges an image shows one, somewhere between them. The same occurs
at a face seen edge-on, whose far side may be occluded at one pose and visible at the next.

Smooth parts are seen by their outlines (occluding contours), where the surface turns away from the viewer:
the zero of N . (p - eye) with normals and positions interpolated over each face (Hertzmann and Zorin,
"Illustrating smooth surfaces", SIGGRAPH 2000). Under a small motion the outline slides over the surface, but
only along the line of sight, which the image does not show: its motion normal to the edge is that of the
material point (tests/planning/edges).

``in_sunlight`` weights the points by their contrast: the difference of radiance across the edge, Lambertian,
with shadows. Each side is a face of the body or the black sky. A face that is turned to the Sun and not in
shadow has the radiance n . s, 1 for a white face normal to the sunlight. An edge between equal radiances is
invisible in the image, whatever its angle. Where one side is a more distant part of the body, the sky is
assumed instead.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial import cKDTree

from polhode.camera import RectifiedRig
from polhode.compiled import compiled_ieee
from polhode.lie import Array, inverse_pose, transform_points
from polhode.planning.edges.edge_model import EdgeKind, EdgeModel, lengths
from polhode.records import Bools, Ints


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
    triangles = np.asarray(model.surface.triangles)
    facing = np.einsum("fk,fk->f", np.asarray(model.surface.face_normals), eye_G - triangles[:, 0]) > 0.0
    soft = soft[facing[soft[:, 2]] != facing[soft[:, 3]]]
    ends = np.asarray(model.surface.vertices)[soft[:, :2]]
    across = np.cross((ends[:, 1] - ends[:, 0])[:, None, :], ends - eye_G)
    across /= np.maximum(np.linalg.norm(across, axis=2, keepdims=True), 1e-300)
    outward = np.asarray(model.surface.face_normals)[soft[:, 2:]].sum(axis=1)
    across *= np.where(np.einsum("nek,nk->n", across, outward) < 0.0, -1.0, 1.0)[:, None, None]
    return Outlines(ends, across, np.asarray(model.part[soft[:, 2]]), np.zeros(len(soft)))


def _of_smooth_surface(model: EdgeModel, eye_G: Array) -> Outlines:
    faces = np.flatnonzero(model.outlined_faces)
    triangles = np.asarray(model.surface.triangles)
    facing = _turned_away(faces, triangles, model.corner_normals_G, eye_G)
    # several times as fast as any and all along so short an axis
    a, b, c = facing.T
    turning = (a | b | c) & ~(a & b & c)
    faces, facing = faces[turning], facing[turning]
    normals, corners = model.corner_normals_G[faces], triangles[faces]
    # The corner that is alone on its side: the outline crosses its two edges.
    alone = np.where(facing.sum(axis=1) == 1, np.argmax(facing, axis=1), np.argmax(~facing, axis=1))
    row = np.arange(len(faces))
    ends = np.zeros((len(faces), 2, 3))
    end_normals = np.zeros((len(faces), 2, 3))
    for side in 0, 1:
        other = (alone + 1 + side) % 3
        t = _crossing(
            corners[row, alone], corners[row, other], normals[row, alone], normals[row, other], eye_G
        )
        ends[:, side] = corners[row, alone] + t[:, None] * (corners[row, other] - corners[row, alone])
        n = normals[row, alone] + t[:, None] * (normals[row, other] - normals[row, alone])
        end_normals[:, side] = n / np.linalg.norm(n, axis=1, keepdims=True)
    chord, turn = corners - np.roll(corners, 1, axis=1), normals - np.roll(normals, 1, axis=1)
    bulge = np.abs(np.einsum("fck,fck->fc", chord, turn)).max(axis=1) / 8.0
    return Outlines(ends, end_normals, np.asarray(model.part[faces]), bulge)


@compiled_ieee
def _turned_away(faces: Ints, corners_G: Array, normals_G: Array, eye_G: Array) -> Bools:
    """(k, 3) corners of the faces (k,) whose normals point away from the eye (3,)."""
    away = np.empty((len(faces), 3), dtype=np.bool_)
    for k in range(len(faces)):
        for c in range(3):
            along = 0.0
            for axis in range(3):
                along += normals_G[faces[k], c, axis] * (corners_G[faces[k], c, axis] - eye_G[axis])
            away[k, c] = along > 0.0
    return away


def _crossing(a: Array, b: Array, normal_a: Array, normal_b: Array, eye_G: Array) -> Array:
    """Fraction (n,) from a to b where interpolated normal and ray to the point are perpendicular.

    (N_a + t dN) . (a - eye + t d) is quadratic in t, with one root between ends of opposite sign.
    """
    d, turn, from_eye = b - a, normal_b - normal_a, a - eye_G
    two = np.einsum("nk,nk->n", turn, d)
    one = np.einsum("nk,nk->n", turn, from_eye) + np.einsum("nk,nk->n", normal_a, d)
    zero = np.einsum("nk,nk->n", normal_a, from_eye)
    root = np.sqrt(np.maximum(one**2 - 4.0 * two * zero, 0.0))
    # numerically stable form of the two roots
    q = -0.5 * (one + np.where(one >= 0.0, root, -root))
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = q / two, zero / q
    inside = (first >= 0.0) & (first <= 1.0)
    return np.asarray(np.clip(np.nan_to_num(np.where(inside, first, second)), 0.0, 1.0))


SPACING_PX = 10.0
"""Spacing of control points along an edge."""
MERGED_PX = 2.0
"""Parallel edges closer than this in the image are merged."""
PARALLEL = 0.97
"""Cosine of the angle between such edges."""
_NEAR = 0.02
"""Near clipping plane, as a share of the body's radius."""


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
    return without_duplicates(every_point(model, rig, X_RG, spacing_px), spacing_px)


def every_point(model: EdgeModel, rig: RectifiedRig, X_RG: Array, spacing_px: float) -> ControlPoints:
    """The same, with all edges that coincide in the image."""
    if model.encloses(inverse_pose(X_RG)[:3, 3]):
        return _no_points()
    near_m = _NEAR * model.radius_m
    segments = _on_segments(model, rig, X_RG, spacing_px, near_m)
    return _join(segments, _on_outlines(model, rig, X_RG, spacing_px, near_m))


def without_duplicates(points: ControlPoints, spacing_px: float) -> ControlPoints:
    """The points without those of an edge that coincides in the image with another, longer one."""
    if len(points) < 2:
        return points
    seen = np.asarray(np.bincount(points.feature, points.weight), dtype=np.float64)
    order = np.argsort(points.uv_px[:, 0], kind="stable")
    keep = np.ones(len(points), dtype=bool)
    _drop_shorter(
        order, points.uv_px, points.normal_px, points.feature, seen[points.feature], 0.75 * spacing_px, keep
    )
    return points[keep]


@compiled_ieee
def _drop_shorter(
    order: Ints, uv: Array, normal: Array, feature: Ints, seen_length: Array, reach_px: float, keep: Bools
) -> None:
    """Unset ``keep`` (m,) of points beside one of a longer edge; ``order`` (m,) of ascending u."""
    widest = np.hypot(MERGED_PX, reach_px)
    for first in range(len(order)):
        for second in range(first + 1, len(order)):
            a, b = min(order[first], order[second]), max(order[first], order[second])
            if uv[order[second], 0] - uv[order[first], 0] > widest:
                break
            du, dv = uv[b, 0] - uv[a, 0], uv[b, 1] - uv[a, 1]
            if feature[a] == feature[b] or abs(dv) > widest:
                continue
            across = abs(du * normal[a, 0] + dv * normal[a, 1])
            along = np.sqrt(max(du * du + dv * dv - across * across, 0.0))
            cosine = abs(normal[a, 0] * normal[b, 0] + normal[a, 1] * normal[b, 1])
            if across < MERGED_PX and along < reach_px and cosine > PARALLEL:
                a_is_longer = seen_length[a] > seen_length[b]
                if a_is_longer or (seen_length[a] == seen_length[b] and feature[a] < feature[b]):
                    keep[b] = False
                else:
                    keep[a] = False


def _on_segments(
    model: EdgeModel, rig: RectifiedRig, X_RG: Array, spacing_px: float, near_m: float
) -> ControlPoints:
    """Points at the centres of equal steps of each segment in the image."""
    ends_R = transform_points(X_RG, model.ends_G.reshape(-1, 3)).reshape(-1, 2, 3)
    piece, share, length_px = _steps(ends_R, rig, spacing_px, near_m)
    p_G = _between(model.ends_G, piece, share)
    tangent_R = _between(model.tangents_G, piece, share) @ X_RG[:3, :3].T
    p_R = transform_points(X_RG, p_G)
    normal, well = _across(np.cross(p_R, tangent_R))
    points = ControlPoints(
        p_G, rig.project(p_R)[:, :2], normal, piece, length_px / spacing_px, model.sides_G[piece]
    )[well]
    # A chord lies inside the arc that it approximates.
    outward = points.sides_G[:, 0] + points.sides_G[:, 1]
    outward /= np.maximum(lengths(outward), 1e-12)[:, None]
    lift = np.where(model.kind[points.feature] == EdgeKind.BOUNDARY, 0.0, 1.5 * model.tolerance_m)
    return _unoccluded(points, model, X_RG, lift[:, None] * outward)


def _on_outlines(
    model: EdgeModel, rig: RectifiedRig, X_RG: Array, spacing_px: float, near_m: float
) -> ControlPoints:
    """Points at equal steps along all outlines of a view, whose pieces are shorter than a step."""
    contours = outlines(model, inverse_pose(X_RG)[:3, 3])
    ends_R = transform_points(X_RG, contours.ends_G.reshape(-1, 3)).reshape(-1, 2, 3)
    piece, share, length_px = _steps(ends_R, rig, spacing_px, near_m)
    piece, share = _thinned(piece, share, length_px, spacing_px)
    p_G, normal_G = _between(contours.ends_G, piece, share), _between(contours.normals_G, piece, share)
    normal_G /= np.maximum(lengths(normal_G), 1e-12)[:, None]
    normal, well = _across(normal_G @ X_RG[:3, :3].T)
    p_R = transform_points(X_RG, p_G)
    feature = len(model.ends_G) + contours.part[piece]
    weight = np.ones(len(piece))
    sides = np.stack([normal_G, normal_G], axis=1)
    points = ControlPoints(p_G, rig.project(p_R)[:, :2], normal, feature, weight, sides)[well]
    lift = model.tolerance_m + 2.0 * contours.bulge_m[piece][well]
    return _unoccluded(points, model, X_RG, lift[:, None] * normal_G[well])


def _unoccluded(points: ControlPoints, model: EdgeModel, X_RG: Array, lift_G: Array) -> ControlPoints:
    """The points that no face occludes, tested slightly above the surface."""
    eye_G = inverse_pose(X_RG)[:3, 3]
    return points[~model.occluder.hides(eye_G, points.p_G + lift_G, 2.0 * model.tolerance_m)]


def _steps(ends_R: Array, rig: RectifiedRig, spacing_px: float, near_m: float) -> tuple[Ints, Array, Array]:
    """Equal steps in the image, at most ``spacing_px`` long, of the parts of segments in the field of view.

    Returns the segment (m,) of each step, the fraction (m,) along the segment in space of its centre, its
    length in the image (m,) [px].
    """
    start, end = _ahead(ends_R, near_m)
    every = np.arange(len(ends_R))
    a_R, b_R = _between(ends_R, every, start), _between(ends_R, every, end)
    visible = (end > start) & (a_R[:, 2] > 0.0) & (b_R[:, 2] > 0.0)
    own = np.flatnonzero(visible)
    a_R, b_R, start, end = a_R[own], b_R[own], start[own], end[own]
    a, b = rig.project(a_R)[:, :2], rig.project(b_R)[:, :2]
    enter, leave = _in_image(a, b, rig)
    length = lengths(b - a) * np.maximum(leave - enter, 0.0)
    count = np.ceil(length / spacing_px).astype(np.int64)
    piece = np.repeat(np.arange(len(own)), count)
    number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    in_image = enter[piece] + (number + 0.5) / count[piece] * (leave - enter)[piece]
    # 1 / z is linear along the image of a segment.
    za, zb = a_R[piece, 2], b_R[piece, 2]
    in_space = in_image / zb / ((1.0 - in_image) / za + in_image / zb)
    share = start[piece] + in_space * (end - start)[piece]
    return own[piece], share, length[piece] / count[piece]


def _thinned(piece: Ints, share: Array, length_px: Array, spacing_px: float) -> tuple[Ints, Array]:
    """Of short steps, those that contain the centres of steps of the full spacing."""
    reached = np.cumsum(length_px) / spacing_px + 0.5
    keep = np.floor(reached) > np.floor(reached - length_px / spacing_px)
    return piece[keep], share[keep]


def _ahead(ends_R: Array, near_m: float) -> tuple[Array, Array]:
    """Fractions (n,) between which segments lie beyond near_m along the optical axis."""
    z0, z1 = ends_R[:, 0, 2], ends_R[:, 1, 2]
    slope = z1 - z0
    at = (near_m - z0) / np.where(np.abs(slope) > 1e-12, slope, 1.0)
    start = np.where(z0 < near_m, np.where(z1 < near_m, 1.0, at), 0.0)
    end = np.where(z1 < near_m, np.where(z0 < near_m, 0.0, at), 1.0)
    return start, end


def _in_image(a: Array, b: Array, rig: RectifiedRig) -> tuple[Array, Array]:
    """Fractions (n,) between which lines a to b (n, 2) [px] lie in the image (Liang and Barsky, 1984)."""
    enter, leave = np.zeros(len(a)), np.ones(len(a))
    for axis, size in enumerate((rig.width_px, rig.height_px)):
        step = b[:, axis] - a[:, axis]
        for sign, bound in (-1.0, -0.5), (1.0, size - 0.5):
            gap = sign * (bound - a[:, axis])
            slope = sign * step
            with np.errstate(divide="ignore", invalid="ignore"):
                at = gap / slope
            enter = np.where(slope < 0.0, np.maximum(enter, at), enter)
            leave = np.where(slope > 0.0, np.minimum(leave, at), leave)
            leave = np.where((slope == 0.0) & (gap < 0.0), 0.0, leave)
    return enter, np.maximum(leave, enter)


@compiled_ieee
def _between(ends: Array, piece: Ints, share: Array) -> Array:
    """Points (m, 3) at fractions (m,) of the segments ``piece`` (m,) of (n, 2, 3)."""
    points = np.empty((len(piece), 3))
    for k in range(len(piece)):
        for axis in range(3):
            start = ends[piece[k], 0, axis]
            points[k, axis] = start + share[k] * (ends[piece[k], 1, axis] - start)
    return points


def _across(plane_R: Array) -> tuple[Array, Bools]:
    """Unit normals (m, 2) in the image of planes through the camera (m, 3), and whether they exist."""
    length = lengths(plane_R[:, :2])
    well = length > 1e-9 * np.maximum(lengths(plane_R), 1e-300)
    return plane_R[:, :2] / np.where(well, length, 1.0)[:, None], np.asarray(well)


def why_no_edge(model: EdgeModel, rig: RectifiedRig, X_RG: Array) -> str:
    """Description of the reason why a view at X_RG (4, 4) shows no edge."""
    if model.encloses(inverse_pose(X_RG)[:3, 3]):
        return "the camera is inside the body"
    vertices_R = transform_points(X_RG, np.asarray(model.surface.vertices))
    ahead = vertices_R[vertices_R[:, 2] > _NEAR * model.radius_m]
    if len(ahead) == 0:
        return "the body is behind the camera"
    u, v = rig.project(ahead)[:, :2].T
    if min(u.max(), v.max()) < -0.5 or u.min() > rig.width_px - 0.5 or v.min() > rig.height_px - 0.5:
        return "the body is outside the image"
    return "all edges are hidden or outside the image"


def _no_points() -> ControlPoints:
    none, ends = np.zeros((0, 3)), np.zeros((0, 2))
    return ControlPoints(none, ends, ends, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 2, 3)))


def _join(first: ControlPoints, second: ControlPoints) -> ControlPoints:
    return ControlPoints(
        *(np.concatenate([getattr(first, item.name), getattr(second, item.name)]) for item in fields(first))
    )


SAME_PX = 0.5
"""Edges with a smaller lateral distance are pieces of one edge."""
EDGE_ON = 0.05
"""Sine of the angle to a face's plane below which it is seen edge-on: half a metre is 4 px wide at 4 m."""
SEPARATION_PX = 4.0


def clear_points(
    model: EdgeModel, rig: RectifiedRig, X_RG: Array, spacing_px: float, separation_px: float = SEPARATION_PX
) -> ControlPoints:
    """Control points of a view, without those that are ambiguous in the image."""
    points = control_points(model, rig, X_RG, spacing_px)
    points = points[~beside_edge_on_face(points, model, X_RG)]
    return points[is_separated(points, separation_px)]


def beside_edge_on_face(points: ControlPoints, model: EdgeModel, X_RG: Array) -> Bools:
    """(m,) whether a point lies on a segment with an adjacent face seen edge-on."""
    ray = points.p_G - inverse_pose(X_RG)[:3, 3]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    sine = np.abs(np.einsum("msk,mk->ms", points.sides_G, ray)).min(axis=1)
    return np.asarray((points.feature < len(model.ends_G)) & (sine < EDGE_ON))


def is_separated(points: ControlPoints, min_px: float) -> Bools:
    """(m,) false where a point of another edge lies within ``min_px`` beside this one, not along it."""
    clear = np.ones(len(points), dtype=bool)
    if len(points) == 0:
        return clear
    pairs = cKDTree(points.uv_px).query_pairs(min_px, output_type="ndarray")
    pairs = pairs[points.feature[pairs[:, 0]] != points.feature[pairs[:, 1]]]
    separation = points.uv_px[pairs[:, 0]] - points.uv_px[pairs[:, 1]]
    for one in pairs.T:
        across = np.abs(np.einsum("mk,mk->m", separation, points.normal_px[one]))
        clear[one[across > SAME_PX]] = False
    return clear


HALF_CONTRAST = 0.1
"""Contrast at which image noise and the error floor (blur, model) displace an edge equally."""
MIN_WEIGHT = 0.01
"""Points with a smaller weight are omitted."""


def contrast(model: EdgeModel, points: ControlPoints, eye_G: Array, sun_G: Array) -> Array:
    """(m,) difference of radiance across the edge at each point, 0 to 1; sun_G (3,) towards the Sun."""
    if len(points) == 0:
        return np.zeros(0)
    sun = sun_G / np.linalg.norm(sun_G)
    segments = len(model.ends_G)
    rim = np.zeros(len(points), dtype=bool)
    on_segment = points.feature < segments
    rim[on_segment] = model.kind[points.feature[on_segment]] == EdgeKind.BOUNDARY
    facing = np.einsum("msk,mk->ms", points.sides_G, eye_G - points.p_G)
    # an open sheet is also visible from behind
    normals = np.where((rim[:, None] & (facing < 0.0))[..., None], -points.sides_G, points.sides_G)
    crease = on_segment & ~rim
    seen = np.where(crease[:, None], facing > 0.0, [True, False])
    # outwards, between the two sides, where both are lit or both in shadow
    outward = np.where(crease[:, None], normals.sum(axis=1), normals[:, 0])
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    start = points.p_G + 3.0 * model.tolerance_m * outward
    lit = ~model.occluder.shades(sun, start, 0.5 * model.tolerance_m)
    radiance = np.where(seen & lit[:, None], np.maximum(normals @ sun, 0.0), 0.0)
    return np.asarray(np.abs(radiance[:, 0] - radiance[:, 1]))


def contrast_weight(contrast: Array, half: float = HALF_CONTRAST) -> Array:
    """Information (m,) of an edge, relative to that at full contrast.

    White image noise displaces an edge in inverse proportion to its contrast c; blur and model add a
    floor: sigma^2 = floor^2 (1 + (half / c)^2).
    """
    square = np.asarray(contrast) ** 2
    return np.asarray(square / (square + half**2))


def in_sunlight(
    model: EdgeModel, points: ControlPoints, eye_G: Array, sun_G: Array, half: float = HALF_CONTRAST
) -> ControlPoints:
    """The points that have contrast, their weights multiplied by `contrast_weight`."""
    share = contrast_weight(contrast(model, points, eye_G, sun_G), half)
    return replace(points, weight=points.weight * share)[share >= MIN_WEIGHT]
