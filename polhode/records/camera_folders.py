"""Which folders of a sequence hold the left and the right camera, or the camera and its range images.

``cam0`` is the left and ``cam1`` the right camera of a sequence that has both. Recordings of larger rigs have
other names (``cam2`` and ``cam3``, ``left`` and ``right``): then the only two folders with images are taken.
With a single camera, ``range0`` takes the place of the right one.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.geometry.lie import inverse_pose
from polhode.records.range_images import RANGE_FOLDER
from polhode.records.rig_calibration import read_camera_pose
from polhode.runtime.errors import InputError

USUAL = ("cam0", "cam1")


@dataclass(frozen=True)
class CameraFolders:
    """The folders of camera 0 (left) and camera 1 (right), or of the ranges in the place of the latter."""

    mav0: Path
    names: tuple[str, str]

    @property
    def has_ranges(self) -> bool:
        """Whether the second folder holds range images."""
        return self.names[1] == RANGE_FOLDER

    def folder(self, camera: int) -> Path:
        """With ``sensor.yaml``, ``data.csv`` and the images in ``data``."""
        return self.mav0 / self.names[camera]

    def masks(self, camera: int) -> Path:
        """masks2 of cam2; masks0 (left) and masks1 (right) of cameras without a number."""
        number = re.fullmatch(r"cam(\d+)", self.names[camera])
        return self.mav0 / f"masks{number[1] if number else camera}"


def find_cameras(mav0: Path) -> CameraFolders:
    """The cameras of a sequence.

    Raises InputError when there are fewer than two cameras and no range images, or more and none are called
    cam0 and cam1.
    """
    if all((mav0 / name).is_dir() for name in USUAL):
        return CameraFolders(mav0, USUAL)
    found = [
        folder.name
        for folder in (mav0.iterdir() if mav0.is_dir() else ())
        if folder.name != RANGE_FOLDER
        and (folder / "data").is_dir()
        and all((folder / name).is_file() for name in ("sensor.yaml", "data.csv"))
    ]
    # cam2 before cam10
    found.sort(
        key=lambda name: [(int(n), "") if n.isdigit() else (-1, n) for n in re.split(r"(\d+)", name) if n]
    )
    if len(found) > 2:
        raise InputError(
            f"{mav0} has {len(found)} cameras, {', '.join(found[:6])}: call the left one of the pair cam0 "
            "and the right one cam1, or move the others out"
        )
    alone = found or [name for name in USUAL[:1] if (mav0 / name).is_dir()]
    if len(alone) == 1 and (mav0 / RANGE_FOLDER).is_dir():
        return CameraFolders(mav0, (alone[0], RANGE_FOLDER))
    if len(found) < 2:
        missing = next(mav0 / name for name in USUAL if not (mav0 / name).is_dir())
        raise InputError(
            f"{missing} is missing: a sequence needs mav0/cam0 and mav0/cam1, or mav0/{RANGE_FOLDER} in the "
            "place of a second camera (see docs/dataset.md)"
        )
    sides = [next((side for side in ("left", "right") if side in name.lower()), None) for name in found]
    is_swapped = sides == ["right", "left"]
    if not is_swapped and sides != ["left", "right"]:
        # Whether the first camera is on the right of the second, by their T_BS; two that are one above the
        # other are taken in the order of their names.
        first, second = (read_camera_pose(mav0 / name / "sensor.yaml") for name in found)
        to_second = (inverse_pose(first) @ second)[:3, 3]
        is_swapped = bool(to_second[0] < -0.5 * np.linalg.norm(to_second))
    left, right = reversed(found) if is_swapped else found
    return CameraFolders(mav0, (left, right))


def left_camera(mav0: Path) -> Path:
    """The folder of the left camera; cam0, which is missing, if there are no two cameras to choose from."""
    try:
        return find_cameras(mav0).folder(0)
    except (InputError, OSError):
        return mav0 / USUAL[0]
