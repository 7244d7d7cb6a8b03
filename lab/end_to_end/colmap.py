"""Structure from motion by COLMAP on the same stereo images, as a rig of known calibration.

COLMAP's incremental mapper with its default options (Schoenberger and Frahm 2016), by pycolmap. It gets the
rectified images, the target's masks, the intrinsics and the baseline, all as exact as they are, so that its
reconstruction has the scale of the rig: to it the target is the world, and the camera moves.
"""

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from lab.end_to_end.found_poses import FoundPoses
from polhode.frontend.rectification import RectifiedPair
from polhode.geometry.camera import RectifiedRig

SIDES = ("left", "right")
SEED = 0


def colmap_poses(pairs: Iterable[RectifiedPair], rig: RectifiedRig) -> FoundPoses:
    """Of the largest reconstruction. Raises ImportError without pycolmap, ValueError if there is none."""
    import pycolmap

    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for frame, pair in enumerate(pairs):
            _write_pair(folder, frame, pair)
        models = _reconstruct(pycolmap, folder, rig)
    if not models:
        raise ValueError("no reconstruction")
    return _found(max(models, key=lambda model: model.num_reg_images()), len(models))


def _write_pair(folder: Path, frame: int, pair: RectifiedPair) -> None:
    """images/SIDE/FRAME.png and, where COLMAP looks for it, the mask masks/SIDE/FRAME.png.png."""
    for side, image, mask in zip(
        SIDES, (pair.left, pair.right), (pair.mask_left, pair.mask_right), strict=True
    ):
        for kind, name, content in (
            ("images", f"{frame:06d}.png", image),
            ("masks", f"{frame:06d}.png.png", 255 * mask.astype(np.uint8)),
        ):
            path = folder / kind / side / name
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), content)


def _reconstruct(pycolmap: Any, folder: Path, rig: RectifiedRig) -> list[Any]:
    database, images = folder / "database.db", folder / "images"
    # COLMAP counts from the corner of a pixel.
    intrinsics = [rig.focal_px, rig.focal_px, rig.cx_px + 0.5, rig.cy_px + 0.5]
    reader = pycolmap.ImageReaderOptions(
        camera_model="PINHOLE", camera_params=",".join(map(str, intrinsics)), mask_path=folder / "masks"
    )
    pycolmap.set_random_seed(SEED)
    pycolmap.extract_features(
        database, images, camera_mode=pycolmap.CameraMode.PER_FOLDER, reader_options=reader
    )
    _join_to_rig(pycolmap, database, rig)
    pycolmap.match_exhaustive(database)
    options = pycolmap.IncrementalPipelineOptions(
        ba_refine_focal_length=False,
        ba_refine_extra_params=False,
        ba_refine_sensor_from_rig=False,
        random_seed=SEED,
    )
    (folder / "models").mkdir()
    return list(pycolmap.incremental_mapping(database, images, folder / "models", options).values())


def _join_to_rig(pycolmap: Any, database: Path, rig: RectifiedRig) -> None:
    """Tell COLMAP that each left image has a right one, displaced by the baseline."""
    right = pycolmap.Rigid3d(pycolmap.Rotation3d(np.eye(3)), np.array([-rig.baseline_m, 0.0, 0.0]))
    cameras = [
        pycolmap.RigConfigCamera(ref_sensor=True, image_prefix="left/"),
        pycolmap.RigConfigCamera(ref_sensor=False, image_prefix="right/", cam_from_rig=right),
    ]
    with pycolmap.Database.open(database) as opened:
        pycolmap.apply_rig_config([pycolmap.RigConfig(cameras=cameras)], opened)


def _found(model: Any, pieces: int) -> FoundPoses:
    poses = {}
    for image in model.images.values():
        side, _, name = image.name.partition("/")
        if side == SIDES[0] and image.has_pose:
            poses[int(Path(name).stem)] = np.vstack([image.cam_from_world().matrix(), [0.0, 0.0, 0.0, 1.0]])
    frames = sorted(poses)
    points = np.array([point.xyz for point in model.points3D.values()])
    return FoundPoses(np.array(frames, dtype=np.int64), np.stack([poses[k] for k in frames]), points, pieces)
