"""Control points: the edges of a model that a camera sees from one pose, sampled every few pixels.

``control_points`` returns each line of the image once, ``every_point`` all edges that coincide there.

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

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, transform_points
from polhode.planning.edges.edge_model import EdgeKind, EdgeModel
from polhode.runtime.compiled import compiled_ieee


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
    """Where N . (p - eye) vanishes on the faces with corners on both sides of the outline."""
    faces = np.flatnonzero(model.outlined_faces)
    most = len(faces)
    ends, end_normals, bulge = np.empty((most, 2, 3)), np.empty((most, 2, 3)), np.empty(most)
    triangles = np.asarray(model.surface.triangles)
    crossed = _cross_faces(faces, triangles, model.corner_normals_G, eye_G, ends, end_normals, bulge)
    k = len(crossed)
    return Outlines(ends[:k], end_normals[:k], model.part[crossed], bulge[:k])


@compiled_ieee
def _cross_faces(
    faces: Ints,
    corners_G: Array,
    normals_G: Array,
    eye_G: Array,
    ends: Array,
    end_normals: Array,
    bulge: Array,
) -> Ints:
    """The faces (k,) that an outline crosses; fills its ends on them, the normals there, and their bulges."""
    crossed = np.empty(len(faces), dtype=np.int64)
    away = np.empty(3, dtype=np.bool_)
    k = 0
    for face in faces:
        corners, normals = corners_G[face], normals_G[face]
        for c in range(3):
            along = 0.0
            for axis in range(3):
                along += normals[c, axis] * (corners[c, axis] - eye_G[axis])
            away[c] = along > 0.0
        if away[0] == away[1] and away[1] == away[2]:
            continue
        # The corner that is alone on its side: the outline crosses its two edges.
        alone = 2 if away[0] == away[1] else (0 if away[1] == away[2] else 1)
        bulge[k] = 0.0
        for side in range(2):
            other = (alone + 1 + side) % 3
            t = _crossing(corners[alone], corners[other], normals[alone], normals[other], eye_G)
            square = 0.0
            for axis in range(3):
                ends[k, side, axis] = corners[alone, axis] + t * (corners[other, axis] - corners[alone, axis])
                n = normals[alone, axis] + t * (normals[other, axis] - normals[alone, axis])
                end_normals[k, side, axis] = n
                square += n * n
            end_normals[k, side] /= np.sqrt(square)
        for c in range(3):
            height = 0.0
            for axis in range(3):
                turn = normals[c, axis] - normals[c - 1, axis]
                height += (corners[c, axis] - corners[c - 1, axis]) * turn
            bulge[k] = max(bulge[k], abs(height) / 8.0)
        crossed[k] = face
        k += 1
    return crossed[:k]


@compiled_ieee
def _crossing(a: Array, b: Array, normal_a: Array, normal_b: Array, eye_G: Array) -> float:
    """Fraction from a to b (3,) where interpolated normal and ray to the point are perpendicular.

    (N_a + t dN) . (a - eye + t d) is quadratic in t, with one root between ends of opposite sign.
    """
    two = one = zero = 0.0
    for axis in range(3):
        d, turn, from_eye = b[axis] - a[axis], normal_b[axis] - normal_a[axis], a[axis] - eye_G[axis]
        two += turn * d
        one += turn * from_eye + normal_a[axis] * d
        zero += normal_a[axis] * from_eye
    root = np.sqrt(max(one * one - 4.0 * two * zero, 0.0))
    # numerically stable form of the two roots
    q = -0.5 * (one + (root if one >= 0.0 else -root))
    first = q / two
    found = first if 0.0 <= first <= 1.0 else zero / q
    return float(min(max(found, 0.0), 1.0)) if np.isfinite(found) else 0.0


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
    piece, share, length_px = _steps(model.ends_G, X_RG, rig, spacing_px, near_m)
    eye_G = inverse_pose(X_RG)[:3, 3]
    p_G, tangent_G = _between(model.ends_G, piece, share), _between(model.tangents_G, piece, share)
    uv, normal, well = _in_image(p_G, np.cross(p_G - eye_G, tangent_G), X_RG, rig)
    free = well & ~model.occluder.hides(
        eye_G, p_G + model.lift_G.take(piece, axis=0), 2.0 * model.tolerance_m
    )
    weight = length_px / spacing_px
    return ControlPoints(p_G, uv, normal, piece, weight, model.sides_G[piece])[free]


def _on_outlines(
    model: EdgeModel, rig: RectifiedRig, X_RG: Array, spacing_px: float, near_m: float
) -> ControlPoints:
    """Points at equal steps along all outlines of a view, whose pieces are shorter than a step."""
    eye_G = inverse_pose(X_RG)[:3, 3]
    contours = outlines(model, eye_G)
    piece, share, length_px = _steps(contours.ends_G, X_RG, rig, spacing_px, near_m)
    piece, share = _thinned(piece, share, length_px, spacing_px)
    p_G, normal_G = _between(contours.ends_G, piece, share), _between(contours.normals_G, piece, share)
    normal_G /= np.maximum(np.linalg.norm(normal_G, axis=1), 1e-12)[:, None]
    uv, normal, well = _in_image(p_G, normal_G, X_RG, rig)
    lift = model.tolerance_m + 2.0 * contours.bulge_m[piece]
    free = well & ~model.occluder.hides(eye_G, p_G + lift[:, None] * normal_G, 2.0 * model.tolerance_m)
    feature = len(model.ends_G) + contours.part[piece]
    sides = np.stack([normal_G, normal_G], axis=1)
    return ControlPoints(p_G, uv, normal, feature, np.ones(len(piece)), sides)[free]


def _steps(
    ends_G: Array, X_RG: Array, rig: RectifiedRig, spacing_px: float, near_m: float
) -> tuple[Ints, Array, Array]:
    """Equal steps in the image, at most ``spacing_px`` long, of the parts of segments in the field of view.

    Returns the segment (m,) of each step, the fraction (m,) along the segment in space of its centre, its
    length in the image (m,) [px].
    """
    ends_R = transform_points(X_RG, ends_G.reshape(-1, 3)).reshape(-1, 2, 3)
    count, span = np.zeros(len(ends_R), dtype=np.int64), np.empty((len(ends_R), 7))
    _measure(ends_R, *_pinhole(rig), rig.width_px, rig.height_px, spacing_px, near_m, count, span)
    piece = np.repeat(np.arange(len(ends_R)), count)
    share, length_px = np.empty(len(piece)), np.empty(len(piece))
    _cut(count, span, share, length_px)
    return piece, share, length_px


@compiled_ieee
def _measure(
    ends_R: Array,
    focal_px: float,
    cx_px: float,
    cy_px: float,
    width_px: int,
    height_px: int,
    spacing_px: float,
    near_m: float,
    count: Ints,
    span: Array,
) -> None:
    """Steps (n,) of each segment, and its span (n, 7) in view.

    That is where it starts and ends along the segment in space, beyond ``near_m``; where the image begins and
    ends between these; their depths; and its length in the image.
    """
    for k in range(len(ends_R)):
        start, end = _ahead(ends_R[k, 0, 2], ends_R[k, 1, 2], near_m)
        a_R = ends_R[k, 0] + start * (ends_R[k, 1] - ends_R[k, 0])
        b_R = ends_R[k, 0] + end * (ends_R[k, 1] - ends_R[k, 0])
        if not (end > start and a_R[2] > 0.0 and b_R[2] > 0.0):
            continue
        au, av = focal_px * a_R[0] / a_R[2] + cx_px, focal_px * a_R[1] / a_R[2] + cy_px
        bu, bv = focal_px * b_R[0] / b_R[2] + cx_px, focal_px * b_R[1] / b_R[2] + cy_px
        enter, leave = _clipped(au, bu - au, width_px - 0.5, 0.0, 1.0)
        enter, leave = _clipped(av, bv - av, height_px - 0.5, enter, leave)
        length = np.hypot(bu - au, bv - av) * max(leave - enter, 0.0)
        if length > 0.0:
            count[k] = int(np.ceil(length / spacing_px))
            span[k, 0], span[k, 1], span[k, 2], span[k, 3] = start, end, enter, leave
            span[k, 4], span[k, 5], span[k, 6] = a_R[2], b_R[2], length


@compiled_ieee
def _cut(count: Ints, span: Array, share: Array, length_px: Array) -> None:
    """Fill the centres (m,) of the steps along their segments and their lengths in the image (m,)."""
    row = 0
    for k in range(len(count)):
        start, end, enter, leave, za, zb, length = span[k]
        for number in range(count[k]):
            in_image = enter + (number + 0.5) / count[k] * (leave - enter)
            # 1 / z is linear along the image of a segment.
            in_space = in_image / zb / ((1.0 - in_image) / za + in_image / zb)
            share[row] = start + in_space * (end - start)
            length_px[row] = length / count[k]
            row += 1


def _thinned(piece: Ints, share: Array, length_px: Array, spacing_px: float) -> tuple[Ints, Array]:
    """Of short steps, those that contain the centres of steps of the full spacing."""
    reached = np.cumsum(length_px) / spacing_px + 0.5
    keep = np.floor(reached) > np.floor(reached - length_px / spacing_px)
    return piece[keep], share[keep]


@compiled_ieee
def _ahead(z0: float, z1: float, near_m: float) -> tuple[float, float]:
    """Fractions between which a segment lies beyond near_m along the optical axis."""
    slope = z1 - z0
    at = (near_m - z0) / (slope if abs(slope) > 1e-12 else 1.0)
    start = 0.0 if z0 >= near_m else (1.0 if z1 < near_m else at)
    end = 1.0 if z1 >= near_m else (0.0 if z0 < near_m else at)
    return start, end


@compiled_ieee
def _clipped(at: float, step: float, end: float, enter: float, leave: float) -> tuple[float, float]:
    """Fractions between which a line lies from -0.5 to ``end`` in one axis, too (Liang and Barsky, 1984)."""
    for sign, bound in ((-1.0, -0.5), (1.0, end)):
        gap, slope = sign * (bound - at), sign * step
        if slope < 0.0:
            enter = max(enter, gap / slope)
        elif slope > 0.0:
            leave = min(leave, gap / slope)
        elif gap < 0.0:
            leave = 0.0
    return enter, max(leave, enter)


def _between(ends: Array, piece: Ints, share: Array) -> Array:
    """Points (m, 3) at fractions (m,) of the segments ``piece`` (m,) of (n, 2, 3)."""
    start = ends[piece, 0]
    return np.asarray(start + share[:, None] * (ends[piece, 1] - start))


def _in_image(p_G: Array, plane_G: Array, X_RG: Array, rig: RectifiedRig) -> tuple[Array, Array, Bools]:
    """Places (m, 2) of points (m, 3) [px], and unit normals (m, 2) of planes (m, 3) through them and the eye.

    And (m,) whether there is such a normal.
    """
    uv, normal = np.empty((len(p_G), 2)), np.empty((len(p_G), 2))
    well = np.empty(len(p_G), dtype=bool)
    _project(p_G, plane_G, np.ascontiguousarray(X_RG), *_pinhole(rig), uv, normal, well)
    return uv, normal, well


@compiled_ieee
def _project(
    p_G: Array,
    plane_G: Array,
    X_RG: Array,
    focal_px: float,
    cx_px: float,
    cy_px: float,
    uv: Array,
    normal: Array,
    well: Bools,
) -> None:
    p_R, plane_R = np.empty(3), np.empty(3)
    for k in range(len(p_G)):
        for axis in range(3):
            p_R[axis], plane_R[axis] = X_RG[axis, 3], 0.0
            for other in range(3):
                p_R[axis] += X_RG[axis, other] * p_G[k, other]
                plane_R[axis] += X_RG[axis, other] * plane_G[k, other]
        uv[k, 0] = focal_px * p_R[0] / p_R[2] + cx_px
        uv[k, 1] = focal_px * p_R[1] / p_R[2] + cy_px
        length = np.hypot(plane_R[0], plane_R[1])
        well[k] = length > 1e-9 * max(np.hypot(length, plane_R[2]), 1e-300)
        normal[k, 0] = plane_R[0] / (length if well[k] else 1.0)
        normal[k, 1] = plane_R[1] / (length if well[k] else 1.0)


def _pinhole(rig: RectifiedRig) -> tuple[float, float, float]:
    return rig.focal_px, rig.cx_px, rig.cy_px


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
