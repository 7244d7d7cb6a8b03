"""Landmarks of a body: marks of its surface that detectors find again from other sides and under other Suns.

A detector's key points on one image are marks of the surface, and edges of shadows, highlights and outlines.
By the truth of the simulator, the key points of all images of a body are carried to its surface. Where those
of several images gather, there is a mark of the surface; the middle of the gathering is its place, with the
drifts that the light gives to single detections averaged out (as homographic adaptation does with views:
DeTone, Malisiewicz, Rabinovich, "SuperPoint", 2018). What gathers nowhere belongs to the light or the noise.

Key points are dense, so some gather by chance: of key points that are displaced at random in each image, half
as many gather in three of nine images within a pixel. The bounds below leave 0.18 (``chance_share``).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from polhode.config.frontend_settings import Features
from polhode.frontend.features.keypoints import find_candidates
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, transform_points
from polhode.train.surface.lit_bodies import LitBody, on_target

DETECTOR = Features(contrast_threshold=0.006, max_features=1500)
"""Key points of single images, more and weaker than in a run."""
KERNEL_PX = 0.5
"""Standard deviation of the kernel in which key points gather [px]."""
GATHER_PX = 0.8
"""Largest distance of a key point from the landmark that it shows [px]."""
MIN_IMAGES = 4
"""Images in which a landmark is detected, at least: with nine images, three gather by chance."""
MIN_SHARE = 0.5
"""The same, over the images that see its place."""
WEAK_IMAGES = 2
"""Gatherings in so many images, which are no landmarks, are no examples of places without one either."""
RIM_PX = 2.5
"""Surface this close to a silhouette or a jump of depth is not used [px]."""
JUMP = 0.03
"""Relative difference of depth between neighbours that counts as a jump."""
MIN_COSINE = 0.25
"""Smallest cosine between the normal and the direction to the camera."""
MIN_GREY = 8.0
"""Smallest grey value of what can be seen."""
_SHIFTS = 6


@dataclass(frozen=True)
class Landmarks:
    """L marks of a body's surface, and the D key points of its V images."""

    p_G: Array
    """(L, 3) [m]"""
    normal_G: Array
    """(L, 3) unit, outwards"""
    share: Array
    """(L,) of the images that see the place in which it is detected; landmarks have ``MIN_SHARE``, the weak
    ones less"""
    is_weak: Bools
    """(L,) no landmark, and no place without one"""
    view: Ints
    """(D,) image of each key point"""
    uv_px: Array
    """(D, 2) in the part"""
    landmark: Ints
    """(D,) that it shows, -1: none"""


@dataclass(frozen=True)
class Seen:
    """n landmarks, or other points of the surface, as an image shows them."""

    index: Ints
    """(n,) among the points"""
    uv_px: Array
    """(n, 2) in the part"""
    p_K: Array
    """(n, 3) [m]"""
    normal_K: Array
    """(n, 3) unit, towards the camera"""


def find_landmarks(body: LitBody, shift_px: Array | None = None) -> Landmarks:
    """The landmarks of a body, weak ones among them.

    shift_px (V, 2): displaces the key points of each image.
    """
    rims = [near_rim(body.depth_m[p]) for p in range(body.poses)]
    shift_px = np.zeros((len(body.grey), 2)) if shift_px is None else shift_px
    view, uv, p_G, normal_G = _detections(body, rims, shift_px)
    nothing = np.zeros(0)
    if len(view) < MIN_IMAGES:
        none = np.full(len(view), -1)
        return Landmarks(np.zeros((0, 3)), np.zeros((0, 3)), nothing, nothing.astype(bool), view, uv, none)
    px_m = float(np.nanmedian(body.depth_m)) / float(body.focal_px)
    places, normals = _gatherings(p_G, normal_G, px_m)
    near = cKDTree(places).query_ball_point(p_G, GATHER_PX * px_m)
    detected = np.zeros((len(places), len(body.grey)), bool)
    owner = np.full(len(view), -1)
    for k, those in enumerate(near):
        if those:
            own = those[int(np.argmin(np.linalg.norm(places[those] - p_G[k], axis=1)))]
            detected[own, view[k]] = True
            owner[k] = own
    visible = np.zeros_like(detected)
    for v in range(len(body.grey)):
        visible[seen_in(body, v, places, normals, rims[body.pose_of(v)]).index, v] = True
    images = (detected & visible).sum(axis=1)
    share = images / np.maximum(visible.sum(axis=1), 1)
    suns = np.stack(
        [
            detected[:, s * body.poses : (s + 1) * body.poses].any(axis=1)
            for s in range(len(body.grey) // body.poses)
        ]
    ).sum(axis=0)
    is_landmark = (images >= MIN_IMAGES) & (share >= MIN_SHARE) & (suns >= 2)
    weak = ~is_landmark & (images >= WEAK_IMAGES)
    kept = np.flatnonzero(is_landmark | weak)
    renumbered = np.full(len(places) + 1, -1)
    renumbered[kept] = np.arange(len(kept))
    landmark = renumbered[owner]
    landmark[(landmark >= 0) & weak[kept][landmark]] = -1
    return Landmarks(places[kept], normals[kept], share[kept], weak[kept], view, uv, landmark)


def chance_share(bodies: Sequence[LitBody], seed: int = 0) -> float:
    """Share of the landmarks that chance explains.

    Their number when the key points of each image are displaced by one vector of 4 to 7 px, over their number
    when they are not.
    """
    rng = np.random.default_rng(seed)
    true, chance = 0, 0
    for body in bodies:
        turn, length = rng.uniform(0.0, 2.0 * np.pi, len(body.grey)), rng.uniform(4.0, 7.0, len(body.grey))
        shift = length[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        true += int(np.sum(~find_landmarks(body).is_weak))
        chance += int(np.sum(~find_landmarks(body, shift).is_weak))
    return chance / max(true, 1)


def seen_in(body: LitBody, view: int, p_G: Array, normal_G: Array, rim: Bools | None = None) -> Seen:
    """Those of the points (n, 3) of the body, with normals (n, 3), that an image shows."""
    pose = body.pose_of(view)
    if rim is None:
        rim = near_rim(body.depth_m[pose])
    X_KG = body.X_KG[pose]
    p_K, normal_K = transform_points(X_KG, p_G), normal_G @ X_KG[:3, :3].T
    uv = p_K[:, :2] / p_K[:, 2:] * float(body.focal_px) + body.centre_of_part_px(pose)
    height, width = body.depth_m.shape[1:]
    pixel = np.round(uv).astype(int)
    inside = ((pixel >= 0) & (pixel < [width, height])).all(axis=1)
    column, row = np.where(inside, pixel[:, 0], 0), np.where(inside, pixel[:, 1], 0)
    cosine = -np.einsum("nk,nk->n", normal_K, p_K / np.linalg.norm(p_K, axis=1, keepdims=True))
    # A pixel may be off by half a pixel, which on an inclined surface is a difference of depth.
    px_m = p_K[:, 2] / float(body.focal_px)
    slack_m = 2.0 * px_m / np.maximum(cosine, MIN_COSINE)
    with np.errstate(invalid="ignore"):
        same = np.abs(body.depth_m[pose][row, column] - p_K[:, 2]) < slack_m
    shown = (
        inside & same & (cosine > MIN_COSINE) & ~rim[row, column] & (body.grey[view][row, column] >= MIN_GREY)
    )
    index = np.flatnonzero(shown)
    return Seen(index, uv[index], p_K[index], normal_K[index])


def surface_at(body: LitBody, pose: int, uv_px: Array) -> tuple[Array, Array]:
    """Points p_K (n, 3) [m] and normals (n, 3) of the surface at places (n, 2) of a part; NaN off the target.

    The plane of the nearest pixel is intersected with the ray.
    """
    height, width = body.depth_m.shape[1:]
    pixel = np.round(uv_px).astype(int)
    column, row = np.clip(pixel[:, 0], 0, width - 1), np.clip(pixel[:, 1], 0, height - 1)
    normal = body.normal_K[pose][row, column].astype(np.float64)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    rays = _rays(body, pose, uv_px)
    at_pixel = _rays(body, pose, np.column_stack([column, row])) * body.depth_m[pose][row, column][:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.einsum("nk,nk->n", normal, at_pixel) / np.einsum("nk,nk->n", normal, rays)
    return rays * depth[:, None], normal


def near_rim(depth_m: NDArray[np.float32]) -> Bools:
    """Pixels (h, w) near the silhouette or a jump of depth."""
    far = np.where(np.isfinite(depth_m), depth_m, 1e6).astype(np.float32)
    edge = far > cv2.erode(far, np.ones((3, 3), np.uint8)) * (1.0 + JUMP)
    away = cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(away <= RIM_PX)


def _rays(body: LitBody, pose: int, uv_px: Array) -> Array:
    """Directions (n, 3) with z = 1."""
    xy = (uv_px - body.centre_of_part_px(pose)) / float(body.focal_px)
    return np.column_stack([xy, np.ones(len(xy))])


def _detections(body: LitBody, rims: list[Bools], shift_px: Array) -> tuple[Ints, Array, Array, Array]:
    """Image (D,), place (D, 2), point (D, 3) and normal (D, 3) in G of all key points on the surface."""
    views, places, points, normals = [], [], [], []
    for v, grey in enumerate(body.grey):
        pose = body.pose_of(v)
        uv = find_candidates(grey, on_target(body, pose), DETECTOR).uv_px + shift_px[v]
        height, width = grey.shape
        uv = uv[((uv >= 0.0) & (uv <= [width - 1.0, height - 1.0])).all(axis=1)]
        if len(uv) == 0:
            continue
        p_K, normal_K = surface_at(body, pose, uv)
        pixel = np.round(uv).astype(int)
        known = np.isfinite(p_K).all(axis=1) & ~rims[pose][pixel[:, 1], pixel[:, 0]]
        cosine = -np.einsum("nk,nk->n", normal_K, p_K) / np.maximum(np.linalg.norm(p_K, axis=1), 1e-9)
        known &= cosine > MIN_COSINE
        X_GK = inverse_pose(body.X_KG[pose])
        views.append(np.full(int(known.sum()), v))
        places.append(uv[known])
        points.append(transform_points(X_GK, p_K[known]))
        normals.append(normal_K[known] @ X_GK[:3, :3].T)
    if not views:
        return np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 3))
    return np.concatenate(views), np.concatenate(places), np.concatenate(points), np.concatenate(normals)


def _gatherings(p_G: Array, normal_G: Array, px_m: float) -> tuple[Array, Array]:
    """Modes (L, 3) of the density of points (D, 3), and the normals (L, 3) there, by mean shift."""
    tree = cKDTree(p_G)
    at = p_G.copy()
    normal = normal_G
    for _ in range(_SHIFTS):
        pairs = (
            cKDTree(at).sparse_distance_matrix(tree, 2.5 * KERNEL_PX * px_m, output_type="coo_matrix").tocsr()
        )
        pairs.data = np.exp(-0.5 * (pairs.data / (KERNEL_PX * px_m)) ** 2)
        total = np.maximum(np.asarray(pairs.sum(axis=1)).ravel(), 1e-9)[:, None]
        at, normal = pairs @ p_G / total, pairs @ normal_G / total
    # Modes closer than the kernel are one: the one with most points.
    order = np.argsort(-total[:, 0], kind="stable")
    groups = cKDTree(at).query_ball_point(at, KERNEL_PX * px_m)
    taken, kept = np.zeros(len(at), bool), []
    for k in order:
        if not taken[k]:
            kept.append(k)
            taken[groups[k]] = True
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return at[kept], normal[kept]
