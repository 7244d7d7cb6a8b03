"""Landmarks of a body: marks of its surface that detectors find again from other sides and under other Suns.

A detector's key points on one image are marks of the surface, and edges of shadows, highlights and outlines.
By the truth of the simulator, the key points of all images of a body are carried to its surface. Where those
of several images gather, there is a mark of the surface; the middle of the gathering is its place, with the
drifts that the light gives to single detections averaged out (as homographic adaptation does with views:
DeTone, Malisiewicz, Rabinovich, "SuperPoint", 2018). What gathers nowhere belongs to the light or the noise.

Key points are dense, so some gather by chance: of key points that are displaced at random in each image, half
as many gather in three of nine images within a pixel. The bounds below leave 0.18 (``chance_share``).
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from polhode.config.frontend_settings import Features
from polhode.config.train_settings import Corpus, SurfaceTraining, Train
from polhode.files.output.single_file import remove_all_partials
from polhode.frontend.features.keypoints import find_candidates
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, transform_points
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress
from polhode.train.corpus import begin_corpus
from polhode.train.descriptor.batches import SurfacePoints
from polhode.train.descriptor.surface_points import near_rim
from polhode.train.stored import array, make_missing, read_record, write_record
from polhode.train.surface.lit_bodies import LitBody, lit_body_path, render_lit_body

VERSION = 2
"""Version of the files of landmarks; those of another version are not used."""
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
RIM_PX = 2.5
"""Surface this close to a silhouette or a jump of depth is not used [px]."""
MIN_COSINE = 0.25
"""Smallest cosine between the normal and the direction to the camera."""
_SHIFTS = 6


@dataclass(frozen=True)
class Landmarks:
    """L marks of a body's surface, and the D key points of its V images."""

    p_G: Array = array("f", 2)
    """(L, 3) [m]"""
    normal_G: Array = array("f", 2)
    """(L, 3) unit, outwards"""
    share: Array = array("f", 1)
    """(L,) of the images that see the place in which it is detected; landmarks have ``MIN_SHARE``, the weak
    ones less"""
    is_weak: Bools = array("b", 1)
    """(L,) no landmark, and no place without one"""
    view: Ints = array("iu", 1)
    """(D,) image of each key point"""
    uv_px: Array = array("f", 2)
    """(D, 2) in the part"""
    landmark: Ints = array("iu", 1)
    """(D,) that it shows, -1: none"""


@dataclass(frozen=True)
class KnownBody:
    """A body's images and landmarks."""

    body: LitBody
    landmarks: Landmarks


def prepare_bodies(
    corpus: Corpus, config: SurfaceTraining, progress: Progress, workers: int
) -> dict[int, KnownBody]:
    """The bodies by their numbers in the corpus; what is missing is rendered, found, and stored.

    Raises InputError: the folder belongs to another corpus, or a file is damaged; RunFailure: a process was
    killed.
    """
    begin_corpus(corpus)
    bodies = {i: lit_body_path(corpus, config, i) for i in range(config.bodies)}
    landmarks = {i: landmarks_path(path) for i, path in bodies.items()}
    remove_all_partials(lit_body_path(corpus, config, 0).parent)
    render = partial(_render, corpus, config)
    make_missing("rendering bodies under several Suns", render, bodies, progress, workers)
    find = partial(_find, corpus, config)
    make_missing("finding landmarks", find, landmarks, progress, workers)
    return {
        i: KnownBody(read_record(bodies[i], LitBody)[0], read_record(landmarks[i], Landmarks)[0])
        for i in bodies
    }


def landmarks_path(body: Path) -> Path:
    """File of the landmarks of a body's file."""
    return body.parents[1] / "landmarks" / f"{body.stem}-v{VERSION}.npz"


def _render(corpus: Corpus, config: SurfaceTraining, index: int) -> None:
    write_record(lit_body_path(corpus, config, index), render_lit_body(corpus, config, index))


def _find(corpus: Corpus, config: SurfaceTraining, index: int) -> None:
    path = lit_body_path(corpus, config, index)
    write_record(landmarks_path(path), find_landmarks(read_record(path, LitBody)[0]))


def corpus_of(train: Train, more: int) -> tuple[Corpus, SurfaceTraining]:
    """The corpus of a training (0), or one of its further ones, counted from 1, and what is made of it.

    Raises InputError: there is no such corpus.
    """
    config = train.surface
    if more == 0:
        return train.corpus, config
    if not 1 <= more <= len(config.more):
        raise InputError(f"train.surface.more has {len(config.more)} entries, and no number {more}")
    entry = config.more[more - 1]
    return entry.corpus, config.model_copy(update={"bodies": entry.bodies})


def find_landmarks(body: LitBody, shift_px: Array | None = None) -> Landmarks:
    """The landmarks of a body, weak ones among them.

    shift_px (V, 2): displaces the key points of each image.
    """
    rims = [near_rim(each, RIM_PX) for each in body.depth_m]
    view, uv, p_G, normal_G = _detections(body, rims, shift_px)
    if len(view) < MIN_IMAGES:
        nothing, none = np.zeros((0, 3)), np.full(len(view), -1)
        return Landmarks(nothing, nothing, np.zeros(0), np.zeros(0, bool), view, uv, none)
    px_m = float(np.nanmedian(body.depth_m)) / float(body.focal_px)
    places, normals = _gatherings(p_G, normal_G, px_m)
    away, owner = cKDTree(places).query(p_G)
    owner = np.where(away <= GATHER_PX * px_m, owner, -1)
    detected = np.zeros((len(places), len(body.grey)), bool)
    detected[owner[owner >= 0], view[owner >= 0]] = True
    visible = np.zeros_like(detected)
    for v in range(len(body.grey)):
        visible[seen_in(body, v, places, normals, rims[body.pose_of(v)])[0], v] = True
    images = (detected & visible).sum(axis=1)
    share = images / np.maximum(visible.sum(axis=1), 1)
    suns = detected.reshape(len(places), -1, body.poses).any(axis=2).sum(axis=1)
    is_landmark = (images >= MIN_IMAGES) & (share >= MIN_SHARE) & (suns >= 2)
    # gatherings in so many images, which are no landmarks, are no examples of places without one either
    kept = np.flatnonzero(is_landmark | (images >= 2))
    number = np.full(len(places) + 1, -1)
    number[kept] = np.where(is_landmark[kept], np.arange(len(kept)), -1)
    return Landmarks(places[kept], normals[kept], share[kept], ~is_landmark[kept], view, uv, number[owner])


def seen_in(
    body: LitBody, view: int, p_G: Array, normal_G: Array, rim: Bools | None = None
) -> tuple[Ints, SurfacePoints]:
    """Those of the points (n, 3) of the body, with normals (n, 3), that an image shows: their indices, and
    where it shows them."""
    pose = body.pose_of(view)
    rim = near_rim(body.depth_m[pose], RIM_PX) if rim is None else rim
    X_KG, rig = body.X_KG[pose], body.rig(pose)
    p_K, normal_K = transform_points(X_KG, p_G), normal_G @ X_KG[:3, :3].T
    uv = rig.project(p_K)[:, :2]
    pixel = np.round(uv).astype(int)
    inside = ((pixel >= 0) & (pixel < [rig.width_px, rig.height_px])).all(axis=1)
    column, row = np.where(inside, pixel[:, 0], 0), np.where(inside, pixel[:, 1], 0)
    cosine = -np.einsum("nk,nk->n", normal_K, p_K / np.linalg.norm(p_K, axis=1, keepdims=True))
    # A pixel may be off by half a pixel, which on an inclined surface is a difference of depth.
    slack_m = 2.0 * p_K[:, 2] / rig.focal_px / np.maximum(cosine, MIN_COSINE)
    with np.errstate(invalid="ignore"):
        same = np.abs(body.depth_m[pose][row, column] - p_K[:, 2]) < slack_m
    bright = body.grey[view][row, column] >= 8.0  # smallest grey value of what can be seen
    index = np.flatnonzero(inside & same & (cosine > MIN_COSINE) & ~rim[row, column] & bright)
    return index, SurfacePoints(uv[index], p_K[index], normal_K[index])


def surface_at(body: LitBody, pose: int, uv_px: Array) -> SurfacePoints:
    """The surface at places (n, 2) of a part; NaN off the target.

    The plane of the nearest pixel is intersected with the ray.
    """
    rig = body.rig(pose)
    pixel = np.clip(np.round(uv_px).astype(int), 0, [rig.width_px - 1, rig.height_px - 1])
    column, row = pixel.T
    normal = body.normal_K[pose][row, column].astype(np.float64)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    rays, at_pixel = (
        np.column_stack([(uv - [rig.cx_px, rig.cy_px]) / rig.focal_px, np.ones(len(uv))])
        for uv in (uv_px, pixel)
    )
    at_pixel *= body.depth_m[pose][row, column][:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.einsum("nk,nk->n", normal, at_pixel) / np.einsum("nk,nk->n", normal, rays)
    return SurfacePoints(uv_px, rays * depth[:, None], normal)


def cosine_to_camera(at: SurfacePoints) -> Array:
    """Cosine (n,) between the normal and the direction to the camera."""
    away = np.maximum(np.linalg.norm(at.p_K, axis=1), 1e-9)
    return np.asarray(-np.einsum("nk,nk->n", at.normal_K, at.p_K) / away)


def _detections(body: LitBody, rims: list[Bools], shift_px: Array | None) -> tuple[Ints, Array, Array, Array]:
    """Image (D,), place (D, 2), point (D, 3) and normal (D, 3) in G of all key points on the surface."""
    views, places = [np.zeros(0, int)], [np.zeros((0, 2))]
    points, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for v, grey in enumerate(body.grey):
        pose = body.pose_of(v)
        uv = find_candidates(grey, body.on_target(pose), DETECTOR).uv_px
        if shift_px is not None:
            uv = uv + shift_px[v]
            height, width = grey.shape
            uv = uv[((uv >= 0.0) & (uv <= [width - 1.0, height - 1.0])).all(axis=1)]
        if len(uv) == 0:
            continue
        at = surface_at(body, pose, uv)
        column, row = np.round(uv).astype(int).T
        known = np.isfinite(at.p_K).all(axis=1) & ~rims[pose][row, column]
        known &= cosine_to_camera(at) > MIN_COSINE
        X_GK = inverse_pose(body.X_KG[pose])
        views.append(np.full(int(known.sum()), v))
        places.append(uv[known])
        points.append(transform_points(X_GK, at.p_K[known]))
        normals.append(at.normal_K[known] @ X_GK[:3, :3].T)
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
