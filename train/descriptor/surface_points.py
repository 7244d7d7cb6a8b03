"""Surface points of a scene: key points of its frames, and their true positions in the other frames.

The ground truth comes from the simulator: rays go through the key points of one frame to the body, and from
there to the other frames. The points are stored beside the corpus.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
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
from polhode.train.corpus import scene_digest, scene_folder
from polhode.train.stored import array, read_record, write_record

VERSION = 2
"""Version of the files; those of another version are not used."""
DETECTOR = Features(contrast_threshold=0.008, max_features=900)
"""More and weaker key points than in a run: the descriptor, not the detector, should be the limit."""
REPEAT_PX = 1.5
"""Largest distance of a redetected key point from the true position [px]."""
RIM_PX = 3.0
"""The patches of key points this close to a silhouette or a depth discontinuity show another surface [px]."""
TRUTHS: tuple[Product, ...] = ("depth", "normals", "mask", "shadow")
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ScenePoints:
    """N key points of F frames, and M sightings of them in other frames."""

    grey: Grey = array("u", 3)
    """(F, H, W) left images"""
    focal_px: Array = array("f", 0)
    """()"""
    centre_px: Array = array("f", 1)
    """(2,) principal point"""
    X_KG: Array = array("f", 3)
    """(F, 4, 4) body in the left camera"""
    frame: Ints = array("iu", 1)
    """(N,)"""
    uv_px: Array = array("f", 2)
    """(N, 2)"""
    p_K: Array = array("f", 2)
    """(N, 3) [m] in the camera of its frame"""
    normal_K: Array = array("f", 2)
    """(N, 3) unit, towards the camera"""
    on_shadow: Bools = array("b", 1)
    """(N,) on the edge of a cast shadow"""
    on_rim: Bools = array("b", 1)
    """(N,) near a silhouette"""
    sift: NDArray[np.float16] = array("f", 2)
    """(N, 128) RootSIFT of the same key points, for comparison"""
    point: Ints = array("iu", 1)
    """(M,) key point that another frame sees"""
    other: Ints = array("iu", 1)
    """(M,) the other frame"""
    again: Ints = array("iu", 1)
    """(M,) key point there within ``REPEAT_PX`` of the true position; -1: none was detected"""
    uv_other_px: Array = array("f", 2)
    """(M, 2) true position there"""
    angle_rad: Array = array("f", 1)
    """(M,) between the two views, at the point"""


def prepare_points(
    corpus: Corpus, scenes: Sequence[int], progress: Progress, workers: int
) -> dict[int, ScenePoints]:
    """The points of the scenes, by their numbers; missing ones are computed and stored."""
    known: dict[int, ScenePoints] = {}
    for i in scenes:
        path = points_path(corpus, i)
        if path.is_file():
            points, made_from = read_record(path, ScenePoints)
            if made_from == scene_digest(scene_folder(corpus, i)):
                known[i] = points
            else:
                _log.warning("%s: was made from another scene; it is made again", path)
    missing = [(corpus, i) for i in scenes if i not in known]
    if missing:
        remove_all_partials(points_path(corpus, 0).parent)
        with progress.stage("finding surface points", len(missing)) as advance:
            for _ in in_order(_make, missing, workers):
                advance()
    return {i: known.get(i) or read_record(points_path(corpus, i), ScenePoints)[0] for i in scenes}


def points_path(corpus: Corpus, index: int) -> Path:
    """File of one scene's points."""
    return Path(corpus.folder) / "points" / f"{index:04d}-v{VERSION}.npz"


def _make(work: tuple[Corpus, int]) -> None:
    folder = scene_folder(*work)
    write_record(points_path(*work), find_points(folder), scene_digest(folder))


def plan_of(folder: Path) -> SequencePlan:
    """The plan of a simulated sequence. Raises InputError: it was not simulated."""
    if not (folder / SCENE_FILE).is_file():
        raise InputError(f"{folder} contains no {SCENE_FILE}: give a sequence of polhode simulate")
    config = load_config(folder / SCENE_FILE)
    assert config.scene is not None  # the file that ``simulate`` wrote
    return plan_sequence(config.scene, config.seed)


def find_points(folder: Path) -> ScenePoints:
    """The points of a simulated sequence with a rectified rig. Raises as ``plan_of``."""
    plan = plan_of(folder)
    frames, camera, stamps = range(plan.scene.frames), plan.cameras[0], plan.target.timestamps_ns
    images = [image_path(folder / "mav0" / "cam0", int(stamps[k])) for k in frames]
    grey = np.stack([np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8) for path in images])
    stored = [products_path(folder / "mav0", 0, int(stamps[k])) for k in frames]
    if all(path.is_file() for path in stored):
        truths = [read_products(path) for path in stored]
    else:
        renderer = Renderer(plan.body, plan.scene, plan.seed)
        truths = [
            render_products(renderer, camera, plan.X_NC[k], plan.target.X_NG[k], TRUTHS) for k in frames
        ]
    return points_of_frames(RayCaster(plan.body), [view_of(plan, k, 0) for k in frames], grey, truths)


def points_of_frames(
    caster: RayCaster, views: Sequence[CameraView], grey: Grey, truths: Sequence[Products]
) -> ScenePoints:
    """The points of images (F, H, W) of one body, each with its view and the truth of its pixels."""
    found = [_detected(view, image, truth) for view, image, truth in zip(views, grey, truths, strict=True)]
    trees = [cKDTree(each["uv_px"]) if len(each["uv_px"]) else None for each in found]
    start = np.cumsum([0, *(len(each["uv_px"]) for each in found)])
    seen: list[dict[str, NDArray[Any]]] = []
    for a, own in enumerate(found):
        for b, tree in enumerate(trees):
            if b == a or len(own["uv_px"]) == 0:
                continue
            there = correspond(caster, views[a], views[b], own["uv_px"])
            point = np.flatnonzero(there.visible)
            uv_b = there.uv_b_px[point]
            again = np.full(len(point), -1)
            if tree is not None and len(point):
                distance, nearest = tree.query(uv_b)
                again = np.where(distance < REPEAT_PX, start[b] + nearest, -1)
            seen.append({
                "point": start[a] + point,
                "other": np.full(len(point), b),
                "again": again,
                "uv_other_px": uv_b,
                "angle_rad": there.angle_rad[point],
            })  # fmt: skip
    camera = views[0].camera
    return ScenePoints(
        grey=grey,
        focal_px=np.array(camera.K[0, 0]),
        centre_px=camera.K[:2, 2],
        X_KG=np.stack([inverse_pose(view.X_GK) for view in views]),
        frame=np.concatenate([np.full(len(each["uv_px"]), k) for k, each in enumerate(found)]),
        **{name: np.concatenate([each[name] for each in found]) for name in found[0]},
        **{name: np.concatenate([each[name] for each in seen]) for name in seen[0]},
    )


def _detected(view: CameraView, grey: Grey, truth: Products) -> dict[str, NDArray[Any]]:
    """Key points of a frame on the target, one per position, with the true properties of their surface."""
    depth, normals, mask, shadow = truth.depth, truth.normals, truth.mask, truth.shadow
    assert depth is not None and normals is not None and mask is not None and shadow is not None
    crop = target_crop(mask)
    points = no_key_points() if crop is None else detect(grey, mask, crop, DETECTOR)
    places, first = np.unique(np.round(points.uv_px * 2.0), axis=0, return_index=True)
    uv = points.uv_px[first]
    column, row = np.round(uv).astype(int).reshape(-1, 2).T
    rays = view.camera.directions(uv) if len(places) else np.zeros((0, 3))
    lit = ((shadow == 0) & mask).astype(np.uint8)
    edge = (shadow == CAST_SHADOW) & (cv2.dilate(lit, np.ones((3, 3), np.uint8)) > 0)
    # largest distance of key points on the edge of a cast shadow from that edge [px]
    return {
        "uv_px": uv,
        "p_K": rays / rays[:, 2:] * depth[row, column][:, None],
        "normal_K": normals[row, column],
        "on_shadow": within(edge, 2.0)[row, column],
        "on_rim": near_rim(depth, RIM_PX)[row, column],
        "sift": points.descriptors[first].astype(np.float16),
    }


def near_rim(depth_m: NDArray[np.floating[Any]], distance_px: float) -> Bools:
    """Pixels (H, W) near the silhouette or a jump of depth; NaN off the target."""
    far = np.where(np.isfinite(depth_m), depth_m, 1e6).astype(np.float32)
    # relative difference of depth between neighbours that counts as a discontinuity
    return within(far > cv2.erode(far, np.ones((3, 3), np.uint8)) * (1.0 + 0.03), distance_px)


def within(marked: Bools, distance_px: float) -> Bools:
    """Pixels (H, W) this close to marked ones."""
    away = cv2.distanceTransform((~marked).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(away <= distance_px)
