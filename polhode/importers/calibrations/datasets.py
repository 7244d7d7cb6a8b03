"""Calibrations of KITTI (calib.txt, calib_cam_to_cam.txt) and of COLMAP (cameras.txt, rigs.txt).

KITTI numbers its cameras: 0 and 1 are grey, 2 and 3 colour, and P of the rectified images has the fourth
column of ROS. Of the images before rectification (K, D, R, T) R and T turn points of camera 0 into this one.
COLMAP's lengths have the scale of its rig; its pixels begin at their corner, half a pixel before others'.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.foreign_files import CONFIGURATION_BYTES, read_text
from polhode.files.tables import numbers_at
from polhode.geometry.lie import Array, make_pose, matrix_from_wxyz
from polhode.importers.calibrations.camera_info import CameraInfo, rig_of
from polhode.importers.calibrations.camera_makers import SizeOfImages
from polhode.importers.calibrations.rig import (
    EQUIDISTANT,
    RADIAL_TANGENTIAL,
    UNDISTORTED,
    Camera,
    Rig,
    camera_of,
    pose_from_inverse,
)
from polhode.runtime.errors import InputError


def is_kitti(content: Mapping[str, Any]) -> bool:
    """Whether this is a calibration of KITTI."""
    return "P0" in content or "P_rect_00" in content


def read_kitti(
    path: Path, content: dict[str, Any], size_of_images: SizeOfImages, cameras: tuple[int, int]
) -> Rig:
    """The rig of two of the cameras. Raises InputError for numbers that are missing."""
    size_px = size_of_images()
    rows = {key: str(value).split() for key, value in content.items()}
    if "P0" in content:
        Ps = [numbers_at(path, rows, f"P{k}", (12,)).reshape(3, 4) for k in cameras]
        return _rectified(path, cameras, Ps, size_px)
    recorded = tuple(numbers_at(path, rows, f"S_{cameras[0]:02d}", (2,)).astype(int).tolist())
    if size_px != recorded:
        Ps = [numbers_at(path, rows, f"P_rect_{k:02d}", (12,)).reshape(3, 4) for k in cameras]
        return _rectified(path, cameras, Ps, size_px)
    found = []
    for k in cameras:
        K, D, R, T = (
            numbers_at(path, rows, f"{name}_{k:02d}", (count,))
            for name, count in (("K", 9), ("D", 5), ("R", 9), ("T", 3))
        )
        X_0C = pose_from_inverse(make_pose(R.reshape(3, 3), T))
        found.append(camera_of(f"{path} camera {k}", K.reshape(3, 3), RADIAL_TANGENTIAL, D, X_0C, size_px))
    return Rig(found[0], found[1]).on_body(np.eye(4))


def _rectified(path: Path, cameras: tuple[int, int], Ps: Sequence[Array], size_px: tuple[int, int]) -> Rig:
    infos = [
        CameraInfo(f"{path} camera {k}", *size_px, UNDISTORTED, (), P[:, :3], np.eye(3), P)
        for k, P in zip(cameras, Ps, strict=True)
    ]
    # a third row of P that is not 0 is a shift along the axis
    shifts = [np.linalg.solve(P[:, :3], P[:, 3]) for P in Ps]
    return rig_of(infos, rectified=True, X_01=pose_from_inverse(make_pose(np.eye(3), shifts[1] - shifts[0])))


_COLMAP_LENSES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": (UNDISTORTED, "f cx cy", ()),
    "PINHOLE": (UNDISTORTED, "fx fy cx cy", ()),
    "SIMPLE_RADIAL": (RADIAL_TANGENTIAL, "f cx cy k1", ("k1", "", "", "")),
    "RADIAL": (RADIAL_TANGENTIAL, "f cx cy k1 k2", ("k1", "k2", "", "")),
    "OPENCV": (RADIAL_TANGENTIAL, "fx fy cx cy k1 k2 p1 p2", ("k1", "k2", "p1", "p2")),
    "FULL_OPENCV": (
        RADIAL_TANGENTIAL,
        "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
        ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    ),
    "SIMPLE_RADIAL_FISHEYE": (EQUIDISTANT, "f cx cy k1", ("k1", "", "", "")),
    "RADIAL_FISHEYE": (EQUIDISTANT, "f cx cy k1 k2", ("k1", "k2", "", "")),
    "OPENCV_FISHEYE": (EQUIDISTANT, "fx fy cx cy k1 k2 k3 k4", ("k1", "k2", "k3", "k4")),
}
"""Model, names of the parameters, and those of the lens in OpenCV's order, empty: 0"""


def is_colmap(folder: Path) -> bool:
    """Whether a folder holds a model of COLMAP."""
    return any((folder / f"cameras.{suffix}").is_file() for suffix in ("txt", "bin"))


def read_colmap(folder: Path) -> Rig:
    """The rig of a model in text. Raises InputError for a binary one, and one without a rig of two
    cameras.
    """
    if not (folder / "cameras.txt").is_file():
        raise InputError(
            f"{folder}: a binary model of COLMAP; write it as text: colmap model_converter --input_path "
            f"{folder} --output_path TEXT --output_type TXT"
        )
    if not (folder / "rigs.txt").is_file():
        raise InputError(
            f"{folder}: a model of COLMAP without rigs.txt, so the distance of the cameras is not stated; "
            "configure the rig (colmap rig_configurator), or give another calibration"
        )
    cameras = {words[0]: words for words in _rows(folder / "cameras.txt") if len(words) >= 5}
    rigs = [words for words in _rows(folder / "rigs.txt") if len(words) >= 13 and words[1] == "2"]
    if not rigs:
        raise InputError(f"{folder / 'rigs.txt'}: no rig of two cameras; give the model of a stereo pair")
    words = rigs[0]
    first, second, has_pose = words[3], words[5], words[6]
    if has_pose != "1" or first not in cameras or second not in cameras:
        raise InputError(f"{folder / 'rigs.txt'}: the second camera has no pose in the rig; state it")
    numbers = numbers_at(folder / "rigs.txt", {"pose": words[7:14]}, "pose", (7,))
    q_wxyz = numbers[:4] / np.linalg.norm(numbers[:4])
    X_10 = make_pose(matrix_from_wxyz(q_wxyz), numbers[4:])
    return Rig(
        _colmap_camera(folder, cameras[first], np.eye(4)),
        _colmap_camera(folder, cameras[second], pose_from_inverse(X_10)),
    )


def _colmap_camera(folder: Path, words: Sequence[str], X_BC: Array) -> Camera:
    path, kind = folder / "cameras.txt", words[1]
    if kind not in _COLMAP_LENSES:
        raise InputError(
            f"{path}: the camera model {kind[:40]!r} is not supported; use {', '.join(_COLMAP_LENSES)}"
        )
    model, names, lens = _COLMAP_LENSES[kind]
    numbers = numbers_at(path, {kind: list(words[4:])}, kind, (len(names.split()),)).tolist()
    value = dict(zip(names.split(), numbers, strict=True))
    fx, fy = (value.get(name, value.get("f", 0.0)) for name in ("fx", "fy"))
    K = [fx, fy, value["cx"] - 0.5, value["cy"] - 0.5]
    coefficients = [value.get(name, 0.0) for name in lens]
    size = numbers_at(path, {kind: list(words[2:4])}, kind, (2,)).tolist()
    return camera_of(f"{path} camera {words[0]}", K, model, coefficients, X_BC, size)


def _rows(path: Path) -> list[list[str]]:
    text = read_text(path, CONFIGURATION_BYTES, "a table of COLMAP")
    return [re.split(r"\s+", line.strip()) for line in text.splitlines() if line.strip()[:1] not in ("", "#")]
