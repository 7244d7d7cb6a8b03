"""Surface points of a scene: key points of its frames, and their true positions in the other frames.

The ground truth comes from the simulator: rays go through the key points of one frame to the body, and from
there to the other frames. The points are stored beside the corpus.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from polhode.config.frontend_settings import Features
from polhode.config.loader import load_config
from polhode.config.scene_settings import Product
from polhode.config.train_settings import Corpus
from polhode.files.array_files import read_arrays, require_arrays
from polhode.files.atomic import replaced
from polhode.files.images import Grey
from polhode.files.output.single_file import remove_all_partials
from polhode.frontend.features.keypoints import detect, no_key_points
from polhode.frontend.rectification import target_crop
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.records.dataset_writer import image_path
from polhode.runtime.errors import InputError
from polhode.runtime.processes import in_order
from polhode.runtime.progress import Progress
from polhode.simulation.dataset.correspondence import CameraView, correspond, view_of
from polhode.simulation.dataset.frame_renderer import (
    CAST_SHADOW,
    Products,
    products_path,
    read_products,
    render_products,
)
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.dataset.sequence import SCENE_FILE
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera
from polhode.train.corpus import scene_digest, scene_folder

VERSION = 2
"""Version of the files; those of another version are not used."""
DETECTOR = Features(contrast_threshold=0.008, max_features=900)
"""More and weaker key points than in a run: the descriptor, not the detector, should be the limit."""
REPEAT_PX = 1.5
"""Largest distance of a redetected key point from the true position [px]."""
SHADOW_PX = 2.0
"""Largest distance of key points on the edge of a cast shadow from that edge [px]."""
RIM_PX = 3.0
"""The patches of key points this close to a silhouette or a depth discontinuity show another surface [px]."""
JUMP = 0.03
"""Relative difference of depth between neighbours that counts as a discontinuity."""


@dataclass(frozen=True)
class ScenePoints:
    """N key points of F frames, and M sightings of them in other frames."""

    grey: Grey
    """(F, H, W) left images"""
    focal_px: Array
    """()"""
    centre_px: Array
    """(2,) principal point"""
    X_KG: Array
    """(F, 4, 4) body in the left camera"""
    frame: Ints
    """(N,)"""
    uv_px: Array
    """(N, 2)"""
    p_K: Array
    """(N, 3) [m] in the camera of its frame"""
    normal_K: Array
    """(N, 3) unit, towards the camera"""
    on_shadow: Bools
    """(N,) on the edge of a cast shadow"""
    on_rim: Bools
    """(N,) near a silhouette"""
    sift: NDArray[np.float16]
    """(N, 128) RootSIFT of the same key points, for comparison"""
    point: Ints
    """(M,) key point that another frame sees"""
    other: Ints
    """(M,) the other frame"""
    again: Ints
    """(M,) key point there within ``REPEAT_PX`` of the true position; -1: none was detected"""
    uv_other_px: Array
    """(M, 2) true position there"""
    angle_rad: Array
    """(M,) between the two views, at the point"""


_DIMENSIONS = {
    "grey": ("u", 3),
    "focal_px": ("f", 0),
    "centre_px": ("f", 1),
    "X_KG": ("f", 3),
    "frame": ("iu", 1),
    "uv_px": ("f", 2),
    "p_K": ("f", 2),
    "normal_K": ("f", 2),
    "on_shadow": ("b", 1),
    "on_rim": ("b", 1),
    "sift": ("f", 2),
    "point": ("iu", 1),
    "other": ("iu", 1),
    "again": ("iu", 1),
    "uv_other_px": ("f", 2),
    "angle_rad": ("f", 1),
}
"""Kind of dtype and number of dimensions of each field of ScenePoints."""
_MADE_FROM = "made_from"
"""In the file beside them: the digest of the scene."""
_log = logging.getLogger(__name__)


def prepare_points(
    corpus: Corpus, scenes: Sequence[int], progress: Progress, workers: int
) -> dict[int, ScenePoints]:
    """The points of the scenes, by their numbers; missing ones are computed and stored."""
    there = {i: _stored(corpus, i) for i in scenes}
    missing = [i for i, points in there.items() if points is None]
    if missing:
        remove_all_partials(points_path(corpus, 0).parent)
        with progress.stage("finding surface points", len(missing)) as advance:
            work = [(corpus, i) for i in missing]
            for _ in in_order(_make, work, workers):
                advance()
    return {i: points or read_points(points_path(corpus, i))[0] for i, points in there.items()}


def points_path(corpus: Corpus, index: int) -> Path:
    """File of one scene's points."""
    return Path(corpus.folder) / "points" / f"{index:04d}-v{VERSION}.npz"


def _stored(corpus: Corpus, index: int) -> ScenePoints | None:
    """The points in the scene's file; None: there is no file, or it was made from another scene."""
    path = points_path(corpus, index)
    if not path.is_file():
        return None
    points, made_from = read_points(path)
    if made_from == scene_digest(scene_folder(corpus, index)):
        return points
    _log.warning("%s: was made from another scene; it is made again", path)
    return None


def read_points(path: Path) -> tuple[ScenePoints, str]:
    """Read what ``write_points`` wrote. Raises InputError for anything else."""
    try:
        arrays: dict[str, Any] = read_arrays(path)
        require_arrays(path, arrays, {**_DIMENSIONS, _MADE_FROM: ("U", 0)})
    except InputError as error:
        raise InputError(f"{error}; remove this file, and it is made again") from None
    return ScenePoints(**{name: arrays[name] for name in _DIMENSIONS}), str(arrays[_MADE_FROM])


def write_points(path: Path, points: ScenePoints, made_from: str) -> None:
    """Write the whole file or nothing; ``made_from``: digest of the scene."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {each.name: getattr(points, each.name) for each in fields(points)}
    with replaced(path) as partial:
        np.savez_compressed(partial, **arrays | {_MADE_FROM: np.array(made_from)})


def _make(work: tuple[Corpus, int]) -> None:
    corpus, index = work
    folder = scene_folder(corpus, index)
    write_points(points_path(corpus, index), find_points(folder), scene_digest(folder))


def find_points(folder: Path) -> ScenePoints:
    """The points of a simulated sequence with a rectified rig."""
    config = load_config(folder / SCENE_FILE)
    assert config.scene is not None  # the file that ``simulate`` wrote
    plan = plan_sequence(config.scene, config.seed)
    caster = RayCaster(plan.body)
    views = [view_of(plan, k, 0) for k in range(config.scene.frames)]
    grey = np.stack([_read_grey(folder, plan, k) for k in range(len(views))])
    return points_of_frames(caster, views, grey, _truths(folder, plan))


def points_of_frames(
    caster: RayCaster, views: Sequence[CameraView], grey: Grey, truths: Sequence[Products]
) -> ScenePoints:
    """The points of images (F, H, W) of one body, each with its view and the truth of its pixels."""
    found = [_detected(views[k].camera, grey[k], truths[k], k) for k in range(len(views))]
    trees = [cKDTree(each["uv_px"]) if len(each["uv_px"]) else None for each in found]
    start = np.cumsum([0, *(len(each["uv_px"]) for each in found)])
    seen = [
        _seen_again(caster, views, k, b, found[k]["uv_px"], trees[b], int(start[k]), int(start[b]))
        for k in range(len(views))
        for b in range(len(views))
        if b != k and len(found[k]["uv_px"])
    ]
    camera = views[0].camera
    per_point = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    per_sighting = {name: np.concatenate([each[name] for each in seen]) for name in seen[0]}
    return ScenePoints(
        grey=grey,
        focal_px=np.array(camera.K[0, 0]),
        centre_px=camera.K[:2, 2],
        X_KG=np.stack([inverse_pose(view.X_GK) for view in views]),
        **per_point,
        **per_sighting,
    )


def _read_grey(folder: Path, plan: SequencePlan, k: int) -> Grey:
    path = image_path(folder / "mav0" / "cam0", int(plan.target.timestamps_ns[k]))
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


def _truths(folder: Path, plan: SequencePlan) -> list[Products]:
    """The ground truth of the left images' pixels, read from disk if it is complete, otherwise rendered."""
    paths = [products_path(folder / "mav0", 0, int(ns)) for ns in plan.target.timestamps_ns]
    if all(path.is_file() for path in paths[: plan.scene.frames]):
        return [read_products(path) for path in paths[: plan.scene.frames]]
    renderer, camera = Renderer(plan.body, plan.scene, plan.seed), plan.cameras[0]
    names: tuple[Product, ...] = ("depth", "normals", "mask", "shadow")
    poses = zip(plan.X_NC, plan.target.X_NG[: plan.scene.frames], strict=True)
    return [render_products(renderer, camera, X_NC, X_NG, names) for X_NC, X_NG in poses]


def _detected(camera: Camera, grey: Grey, truth: Products, k: int) -> dict[str, NDArray[Any]]:
    """Key points of frame k on the target, one per position, with the true properties of their surface."""
    assert truth.mask is not None
    assert truth.depth is not None
    assert truth.normals is not None
    crop = target_crop(truth.mask)
    points = no_key_points() if crop is None else detect(grey, truth.mask, crop, DETECTOR)
    places, first = np.unique(np.round(points.uv_px * 2.0), axis=0, return_index=True)
    uv = points.uv_px[first]
    pixel = np.round(uv).astype(int).reshape(-1, 2)
    depth_m = truth.depth[pixel[:, 1], pixel[:, 0]]
    rays = camera.directions(uv) if len(places) else np.zeros((0, 3))
    return {
        "frame": np.full(len(uv), k),
        "uv_px": uv,
        "p_K": rays / rays[:, 2:] * depth_m[:, None],
        "normal_K": truth.normals[pixel[:, 1], pixel[:, 0]],
        "on_shadow": _near_shadow_edge(truth)[pixel[:, 1], pixel[:, 0]],
        "on_rim": _near_rim(truth)[pixel[:, 1], pixel[:, 0]],
        "sift": points.descriptors[first].astype(np.float16),
    }


def _near_shadow_edge(truth: Products) -> Bools:
    """Pixels (H, W) near the edge of a cast shadow."""
    assert truth.shadow is not None
    assert truth.mask is not None
    cast, lit = truth.shadow == CAST_SHADOW, (truth.shadow == 0) & truth.mask
    touching = np.ones((3, 3), np.uint8)
    edge = cast & (cv2.dilate(lit.astype(np.uint8), touching) > 0)
    return _within(edge, SHADOW_PX)


def _near_rim(truth: Products) -> Bools:
    """Pixels (H, W) near the silhouette or a jump of depth."""
    assert truth.depth is not None
    far = np.where(np.isfinite(truth.depth), truth.depth, 1e6).astype(np.float32)
    nearest = cv2.erode(far, np.ones((3, 3), np.uint8))
    return _within(far > nearest * (1.0 + JUMP), RIM_PX)


def _within(marked: Bools, distance_px: float) -> Bools:
    away = cv2.distanceTransform((~marked).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(away <= distance_px)


def _seen_again(
    caster: RayCaster,
    views: Sequence[CameraView],
    a: int,
    b: int,
    uv_px: Array,
    tree: cKDTree | None,
    start_a: int,
    start_b: int,
) -> dict[str, NDArray[Any]]:
    """Key points of frame a that frame b sees: their positions, and the corresponding key points of b."""
    found = correspond(caster, views[a], views[b], uv_px)
    seen = np.flatnonzero(found.visible)
    uv_b = found.uv_b_px[seen]
    again = np.full(len(seen), -1)
    if tree is not None and len(seen):
        distance, nearest = tree.query(uv_b)
        again = np.where(distance < REPEAT_PX, start_b + nearest, -1)
    return {
        "point": start_a + seen,
        "other": np.full(len(seen), b),
        "again": again,
        "uv_other_px": uv_b,
        "angle_rad": found.angle_rad[seen],
    }
