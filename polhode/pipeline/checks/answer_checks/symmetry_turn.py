"""Whether the images show the turn of a body of revolution about its axis of symmetry.

Turned about its axis, a body of revolution looks the same but for the marks on its surface: what stands still
in the image (outline, rings, shadows, reflections) fits any rate. A motion whose landmarks lie there agrees
with itself at the wrong rate, and no residual shows it.

1. The axis: the rotation that moves the surface along itself. Of all screw motions w x p + v it has the least
   velocity along the normals ("slippable", Gelfand and Guibas, Shape segmentation using local slippage
   analysis, SGP 2004). A body is symmetric if that velocity is small against the velocity of its points, and
   if points that are moved along remain within the outline: plates move along themselves, too, but leave it.
2. The marks: the grey values, less their local mean, less their median along the circles around the axis.
3. The turn: points of one frame are moved to the next by the motion found and a further turn about the axis,
   and the marks of both are correlated. The motion found must fit better than any other turn that moves the
   surface by more than ``APART_PX``. For a target that, as found, does not turn about its axis, what it is
   better by counts in proportion to the share of the surface with marks: the edges of shadows and reflections
   would stand still at any rate.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, exp_so3, inverse_pose, log_so3, make_pose, transform_points
from polhode.records.metrics import angle_deg
from polhode.records.surface import DepthMap
from polhode.run_directory.check_table import make_check
from polhode.run_directory.summary_schema import Check

MAX_SLIP = 0.1
"""Velocity along the normals over that of the points, root mean square, of a body of revolution. Measured
ones have 0.04 to 0.09, other bodies at least 0.12."""
APART_PX = 6.0
"""Displacement of the surface from where on a turn is another one."""
MAX_BEYOND = 0.3
"""Share of the points that leave the outline as they are turned about the axis of a body of revolution.
Dishes and stages have up to 0.16, a bus with two wings 0.54."""
MAX_PAIRS, MAX_TURN_DEG = 10, 40.0
"""Pairs of successive frames that are compared, chosen evenly; rotation between them, beyond which the
surface looks too different."""
MAX_SIDE_PX = 640
"""Larger pictures are reduced."""
MIN_POINTS, MAX_POINTS = 300, 2500
"""Of a frame"""
NOTHING_IN_COMMON = -1.0
"""In the place of a correlation: too few points are seen in both frames."""


@dataclass(frozen=True)
class Picture:
    """The target in one image, reduced to at most MAX_SIDE_PX."""

    marks: NDArray[np.float32]
    """(h, w) grey values less their local mean"""
    inside: NDArray[np.float32]
    """(h, w) 1 on the target, away from its edge"""
    target: Bools
    """(h, w) the target, its gaps closed"""
    first_px: Array
    """(2,) pixel (u, v) of the full image at its corner"""
    stride: int
    X_RG: Array
    """(4, 4)"""


@dataclass(frozen=True)
class PairView:
    """Two successive frames, and points of the first one."""

    p_G: Array
    """(n, 3) [m]"""
    normal_G: Array
    """(n, 3) outward unit normals"""
    radius_px: float
    """Pixels of a displacement by 1 m at the target's distance"""
    pictures: tuple[Picture, Picture]


@dataclass(frozen=True)
class Axis:
    """A rotation that moves a surface along itself."""

    point_G: Array
    """(3,) [m]"""
    direction_G: Array
    """(3,) unit"""
    slip: float
    """Velocity along the normals over that of the points, root mean square"""
    radius_m: float
    """Of the points from the axis, root mean square"""


def views_of_pairs(
    maps: Sequence[DepthMap], X_RG: Array, measured: Bools, rig: RectifiedRig
) -> list[PairView]:
    """Some pairs of successive frames. maps: of all F frames, in order; X_RG (F, 4, 4); measured (F,): with
    measurements of their own.
    """
    R = X_RG[:, :3, :3]
    turn_deg = angle_deg(np.swapaxes(R[:-1], 1, 2) @ R[1:])
    fit = 1 + np.flatnonzero((turn_deg < MAX_TURN_DEG) & measured[:-1] & measured[1:])
    at = np.linspace(0, len(fit) - 1, min(MAX_PAIRS, len(fit))).round().astype(np.int64)
    pairs = (pair_view(maps[k - 1], maps[k], (X_RG[k - 1], X_RG[k]), rig) for k in fit[at].tolist())
    return [view for view in pairs if view is not None]


def pair_view(
    first: DepthMap, second: DepthMap, X_RG: tuple[Array, Array], rig: RectifiedRig
) -> PairView | None:
    """What is kept of a pair; None: too little of the target is known."""
    pictures = (_picture(first, X_RG[0]), _picture(second, X_RG[1]))
    if pictures[0] is None or pictures[1] is None:
        return None
    p_R, normal_R = _surface_points(first, pictures[0], rig)
    if len(p_R) < MIN_POINTS:
        return None
    X_GR = inverse_pose(X_RG[0])
    px_per_m = rig.focal_px / float(np.median(p_R[:, 2]))
    return PairView(
        transform_points(X_GR, p_R), normal_R @ X_GR[:3, :3].T, px_per_m, (pictures[0], pictures[1])
    )


def rotation_check(views: Sequence[PairView], rig: RectifiedRig, interval_s: float) -> Check:
    """Whether the rotation about the axis of symmetry shows; without a value where there is no such axis."""
    key = "symmetry rotation"
    if len(views) < 3:
        return make_check(key, None)
    axis = slippable_axis(
        np.concatenate([view.p_G for view in views]), np.concatenate([view.normal_G for view in views])
    )
    if axis.slip > MAX_SLIP or share_beyond_outline(views, axis, rig) > MAX_BEYOND:
        return make_check(key, None)
    per_rad_px = axis.radius_m * float(np.median([view.radius_px for view in views]))
    # turns of up to 45 deg to either side, by 1.5 px of the surface, at most 40
    most_rad, apart_rad = np.deg2rad(45.0), APART_PX / per_rad_px
    step_rad = max(1.5 / per_rad_px, most_rad / 40)
    count = max(int(most_rad / step_rad), 1)
    turns_rad = step_rad * np.arange(-count, count + 1)
    fit, marked = turn_agreement(views, axis, rig, turns_rad)
    found_rad = [
        log_so3(view.pictures[0].X_RG[:3, :3].T @ view.pictures[1].X_RG[:3, :3]) @ axis.direction_G
        for view in views
    ]
    still = abs(float(np.median(found_rad))) < 0.5 * apart_rad
    other = np.where(np.abs(turns_rad) >= apart_rad, fit, -np.inf)
    best = int(np.argmax(other))
    own = float(fit[len(fit) // 2])
    if not np.isfinite(own) or not np.isfinite(other[best]) or own == NOTHING_IN_COMMON:
        return make_check(key, None)
    contrast = (own - float(other[best])) * (marked if still else 1.0)
    doubt = (
        "its surface shows too little of it: the images fit"
        if contrast >= -0.05
        else "the images contradict it: they fit better"
    )
    rate_deg_s = abs(float(np.rad2deg(turns_rad[best])) / interval_s)
    return make_check(key, contrast, doubt=doubt, rate_deg_s=rate_deg_s, own=own, other=other[best])


def slippable_axis(p_G: Array, normal_G: Array) -> Axis:
    """The rotation that moves points (n, 3) with normals (n, 3) least along the normals."""
    centre = p_G.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((p_G - centre) ** 2, axis=1))))
    q = (p_G - centre) / size
    rows = np.hstack([np.cross(q, normal_G), normal_G])
    kept = np.ones(len(p_G), dtype=bool)
    for _ in range(8):
        M = rows[kept].T @ rows[kept] / kept.sum()
        # the best translation for each rotation; the small term bounds it on planes
        best = -np.linalg.solve(M[3:, 3:] + 1e-4 * np.eye(3), M[3:, :3])
        values, vectors = np.linalg.eigh(M[:3, :3] + M[:3, 3:] @ best)
        w = vectors[:, 0]
        v = best @ w
        along = np.abs(rows @ np.concatenate([w, v]))
        # a tenth of the surface may differ: struts, antennas
        kept = along <= np.quantile(along, 1.0 - 0.1)
    point = centre + size * np.cross(w, v)
    radius = np.linalg.norm(np.cross(p_G - point, w), axis=1)
    return Axis(point, w, float(np.sqrt(max(values[0], 0.0))), float(np.sqrt(np.mean(radius**2))))


def share_beyond_outline(views: Sequence[PairView], axis: Axis, rig: RectifiedRig) -> float:
    """Share of the points that leave the outline as they are turned about the axis by 30 and 60 degrees.

    Only where the normals hardly turn, so that light and visibility remain: what is dark is not beyond.
    """
    beyond, count = 0, 0
    for R in exp_so3(np.deg2rad([-60.0, -30.0, 30.0, 60.0])[:, None] * axis.direction_G):
        X_GG = make_pose(R, axis.point_G - R @ axis.point_G)
        for view in views:
            picture = view.pictures[0]
            normal_G = view.normal_G @ R.T
            alike = np.sum(normal_G * view.normal_G, axis=1) > np.cos(np.deg2rad(30.0))
            X = picture.X_RG @ X_GG
            p_R, normal_R = transform_points(X, view.p_G), normal_G @ picture.X_RG[:3, :3].T
            seen = alike & _faces_camera(p_R, normal_R)
            uv = (rig.project(p_R[seen])[:, :2] - picture.first_px) / picture.stride
            inside = map_coordinates(picture.target.astype(np.float32), uv.T[::-1], order=0)
            beyond += int(np.sum(inside < 0.5))
            count += len(inside)
    return beyond / count if count >= MIN_POINTS else 0.0


def _faces_camera(p_R: Array, normal_R: Array) -> Bools:
    """(n,) whether points with these normals are turned towards the camera."""
    facing = -np.sum(p_R * normal_R, axis=1) > 0.25 * np.linalg.norm(p_R, axis=1)
    return np.asarray(facing & (p_R[:, 2] > 1e-6))


def turn_agreement(
    views: Sequence[PairView], axis: Axis, rig: RectifiedRig, turns_rad: Array
) -> tuple[Array, float]:
    """Correlation (n,) of the marks of successive frames for each further turn, and the share of the surface
    that has marks: medians over the pairs.
    """
    R = exp_so3(turns_rad[:, None] * axis.direction_G)
    X_GG = make_pose(R, axis.point_G - R @ axis.point_G)
    fits, shares = [], []
    for view in views:
        before, after = (_marks_along_circles(view, picture, X_GG, rig) for picture in view.pictures)
        mark = before[:, len(turns_rad) // 2]
        known = np.abs(mark[np.isfinite(mark)])
        shares.append(float(np.mean(known > 5.0)) if len(known) else 0.0)
        fits.append([_correlation(mark, column) for column in after.T])
    with np.errstate(all="ignore"):
        return np.asarray(np.median(np.array(fits), axis=0)), float(np.median(shares))


def _marks_along_circles(view: PairView, picture: Picture, X_GG: Array, rig: RectifiedRig) -> Array:
    """(points, turns) grey values of the turned points less the median along the circle; NaN: not seen."""
    out = np.full((len(view.p_G), len(X_GG)), np.nan)
    for j, X in enumerate(picture.X_RG @ X_GG):
        p_R, normal_R = transform_points(X, view.p_G), view.normal_G @ X[:3, :3].T
        seen = np.flatnonzero(_faces_camera(p_R, normal_R))
        u, v = ((rig.project(p_R[seen])[:, :2] - picture.first_px) / picture.stride).T
        inside = map_coordinates(picture.inside, [v, u], order=1, mode="constant") > 0.99
        out[seen[inside], j] = map_coordinates(picture.marks, [v[inside], u[inside]], order=1)
    known = np.isfinite(out)
    enough = known.mean(axis=1) > 0.4
    out[~enough] = np.nan
    out[enough] -= np.nanmedian(out[enough], axis=1, keepdims=True) if enough.any() else 0.0
    # a reflection counts no more than this
    return np.asarray(np.clip(out, -40.0, 40.0))


def _correlation(a: Array, b: Array) -> float:
    """Of values (n,) that are both known; NOTHING_IN_COMMON: too few."""
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < MIN_POINTS // 3:
        return NOTHING_IN_COMMON
    x, y = a[both], b[both]
    return float(np.sum(x * y) / np.sqrt(np.sum(x**2) * np.sum(y**2) + 1e-9))


def _picture(frame: DepthMap, X_RG: Array) -> Picture | None:
    """The part of the image where depth is known; None: there is none."""
    known = np.isfinite(frame.depth_m)
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return None
    v0, v1, u0, u1 = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    stride = -(-max(v1 - v0, u1 - u0) // MAX_SIDE_PX)
    fine = frame.intensity[v0:v1, u0:u1].astype(np.float32)
    coarse = cv2.blur(fine, (int(stride), int(stride))) if stride > 1 else fine
    grey, inside = coarse[::stride, ::stride], known[v0:v1:stride, u0:u1:stride].astype(np.float32)
    around = np.maximum(cv2.GaussianBlur(inside, (0, 0), 3.0), 1e-3)
    marks = inside * (grey - cv2.GaussianBlur(grey * inside, (0, 0), 3.0) / around)
    away = cv2.erode(inside, np.ones((9, 9), np.uint8), borderValue=0.0)
    closed = np.asarray(cv2.dilate(inside, np.ones((7, 7), np.uint8)) > 0.0)
    grey_marks, inner = np.asarray(marks, np.float32), np.asarray(away, np.float32)
    return Picture(grey_marks, inner, closed, np.array([u0, v0], dtype=np.float64), int(stride), X_RG)


def _surface_points(frame: DepthMap, picture: Picture, rig: RectifiedRig) -> tuple[Array, Array]:
    """Some points (n, 3) and normals (n, 3) of the visible surface, in the camera, away from edges."""
    stride, (u0, v0) = picture.stride, picture.first_px.astype(int)
    height, width = picture.marks.shape
    depth = frame.depth_m[v0::stride, u0::stride][:height, :width]
    known = np.isfinite(depth)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), 1.5)
    z = cv2.GaussianBlur(np.where(known, depth, 0.0).astype(np.float32), (0, 0), 1.5)
    z = np.where(known, z / np.maximum(weight, 1e-3), 1.0).astype(np.float64)
    v, u = np.mgrid[0:height, 0:width]
    rays = np.stack([(u0 + stride * u - rig.cx_px), (v0 + stride * v - rig.cy_px)], axis=2) / rig.focal_px
    p_R = np.concatenate([rays, np.ones((height, width, 1))], axis=2) * z[..., None]
    step = 3
    ahead, down = np.zeros_like(p_R), np.zeros_like(p_R)
    ahead[:, step:-step] = p_R[:, 2 * step :] - p_R[:, : -2 * step]
    down[step:-step] = p_R[2 * step :] - p_R[: -2 * step]
    normal = np.cross(down, ahead)
    length = np.linalg.norm(normal, axis=2)
    smooth = np.abs(ahead[..., 2]) + np.abs(down[..., 2]) < 0.06 * z
    inner = cv2.erode(known.astype(np.uint8), np.ones((2 * step + 3,) * 2, np.uint8), borderValue=0) > 0
    fit = inner & smooth & (length > 0.0)
    at = np.flatnonzero(fit)
    # the same points in every run
    at = at[np.linspace(0, len(at) - 1, min(MAX_POINTS, len(at))).astype(np.int64)]
    normals = normal.reshape(-1, 3)[at] / length.reshape(-1)[at, None]
    return np.asarray(p_R.reshape(-1, 3)[at]), np.asarray(normals, dtype=np.float64)
