"""Settings of SLAM programs that hold a calibration: ORB-SLAM2 and 3, VINS-Fusion, Basalt.

ORB-SLAM3 states the right camera in the left one (Stereo.T_c1_c2) or, of rectified images, the baseline
(Stereo.b; Camera.bf over the focal length in earlier versions). VINS-Fusion names a file for each camera and
states each in the body (body_T_cam0), Basalt each in the IMU (T_imu_cam).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.tables import numbers_at
from polhode.geometry.lie import Array, make_pose, matrix_from_wxyz
from polhode.importers.calibrations.camera_info import CameraInfo, rig_of
from polhode.importers.calibrations.content import read_content
from polhode.importers.calibrations.rig import (
    EQUIDISTANT,
    RADIAL_TANGENTIAL,
    UNDISTORTED,
    Camera,
    Rig,
    camera_of,
)
from polhode.runtime.errors import InputError


def is_orb_slam(content: Mapping[str, Any]) -> bool:
    """Whether these are settings of ORB-SLAM."""
    return "Camera1.fx" in content or "Camera.fx" in content


def read_orb_slam(path: Path, content: dict[str, Any]) -> Rig:
    """The rig. Raises InputError for a single camera, and for what is missing."""
    if "LEFT.K" in content and "RIGHT.K" in content:
        return rig_of([_orb_slam_info(path, content, side) for side in ("LEFT", "RIGHT")])
    if any(key.endswith("DepthMapFactor") for key in content):
        raise InputError(f"{path}: settings of ORB-SLAM for a camera with depth; give those of a stereo pair")
    first = "Camera1" if "Camera1.fx" in content else "Camera"
    kind = str(content.get("Camera.type", "PinHole"))
    size = [_number(path, content, f"Camera.{side}") for side in ("width", "height")]
    X_01 = np.eye(4)
    if "Stereo.T_c1_c2" in content:
        X_01 = numbers_at(path, content, "Stereo.T_c1_c2", (16,)).reshape(4, 4) + 0.0
    elif "Tlr" in content:
        X_01[:3] = numbers_at(path, content, "Tlr", (12, 16)).reshape(-1, 4)[:3]
    elif "Stereo.b" in content:
        X_01[0, 3] = _number(path, content, "Stereo.b")
    elif "Camera.bf" in content:
        X_01[0, 3] = _number(path, content, "Camera.bf") / _number(path, content, f"{first}.fx")
    else:
        raise InputError(
            f"{path}: settings of ORB-SLAM for one camera; give those of a stereo pair, with Stereo.T_c1_c2 "
            "or Stereo.b"
        )
    second = "Camera2" if "Camera2.fx" in content else first
    left, right = (
        _orb_slam_camera(path, content, name, kind, X, size)
        for name, X in ((first, np.eye(4)), (second, X_01))
    )
    return Rig(left, right)


def _orb_slam_camera(
    path: Path, content: dict[str, Any], name: str, kind: str, X_BC: Array, size: list[float]
) -> Camera:
    K = [_number(path, content, f"{name}.{key}") for key in ("fx", "fy", "cx", "cy")]
    fisheye = kind == "KannalaBrandt8"
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    found = [float(content.get(f"{name}.{key}", 0.0)) for key in keys]
    is_bare = kind == "Rectified" or not any(found)
    model = UNDISTORTED if is_bare else EQUIDISTANT if fisheye else RADIAL_TANGENTIAL
    return camera_of(f"{path} {name}", K, model, [] if is_bare else found, X_BC, size)


def _orb_slam_info(path: Path, content: dict[str, Any], side: str) -> CameraInfo:
    """What ORB-SLAM2 states of a camera before rectification: the numbers of camera_info."""
    width, height = (int(_number(path, content, f"{side}.{name}")) for name in ("width", "height"))
    D = tuple(numbers_at(path, content, f"{side}.D", (0, 4, 5, 8)).tolist())
    K, R, P = (
        numbers_at(path, content, f"{side}.{name}", (3 * columns,)).reshape(3, columns)
        for name, columns in (("K", 3), ("R", 3), ("P", 4))
    )
    return CameraInfo(f"{path} {side}", width, height, "plumb_bob", D, K, R, P)


def is_vins(content: Mapping[str, Any]) -> bool:
    """Whether these are settings of VINS-Fusion."""
    return "body_T_cam0" in content or "cam0_calib" in content


def read_vins(path: Path, content: dict[str, Any]) -> Rig:
    """The rig, the files of whose cameras lie beside the settings. Raises InputError."""
    cameras = []
    for index in (0, 1):
        if f"cam{index}_calib" not in content:
            raise InputError(
                f"{path} lacks cam{index}_calib: give the settings of VINS-Fusion for a stereo pair"
            )
        name = str(content[f"cam{index}_calib"])
        if Path(name).name != name:
            raise InputError(f"{path}: cam{index}_calib leads out of its folder; put that file beside it")
        X_BC = numbers_at(path, content, f"body_T_cam{index}", (16,)).reshape(4, 4) + 0.0
        place = path.parent / name
        cameras.append(_vins_camera(place, read_content(place, "the file of each camera"), X_BC))
    return Rig(cameras[0], cameras[1])


def _vins_camera(path: Path, content: dict[str, Any], X_BC: Array) -> Camera:
    size = [_number(path, content, f"image_{side}") for side in ("width", "height")]
    kind = str(content.get("model_type", "PINHOLE"))
    parts = {name: content.get(f"{name}_parameters", {}) for name in ("projection", "distortion")}
    projection, distortion = (part if isinstance(part, dict) else {} for part in parts.values())
    if kind == "KANNALA_BRANDT":
        K = [_number(path, projection, key) for key in ("mu", "mv", "u0", "v0")]
        lens = [_number(path, projection, key) for key in ("k2", "k3", "k4", "k5")]
        return camera_of(str(path), K, EQUIDISTANT, lens, X_BC, size)
    if kind != "PINHOLE":
        raise InputError(f"{path}: model_type {kind[:40]!r} is not supported; calibrate as PINHOLE")
    K = [_number(path, projection, key) for key in ("fx", "fy", "cx", "cy")]
    lens = [_number(path, distortion, key) for key in ("k1", "k2", "p1", "p2")]
    return camera_of(str(path), K, RADIAL_TANGENTIAL, lens, X_BC, size)


_BASALT_LENSES = {
    "pinhole": (UNDISTORTED, ()),
    "pinhole-radtan8": (RADIAL_TANGENTIAL, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "kb4": (EQUIDISTANT, ("k1", "k2", "k3", "k4")),
}


def is_basalt(content: Mapping[str, Any]) -> bool:
    """Whether this is a calibration of Basalt."""
    return isinstance(content.get("T_imu_cam"), list) and isinstance(content.get("intrinsics"), list)


def read_basalt(path: Path, content: dict[str, Any]) -> Rig:
    """The rig. Raises InputError for lenses that are no pinhole and no Kannala-Brandt."""
    poses, lenses, sizes = (content.get(key, []) for key in ("T_imu_cam", "intrinsics", "resolution"))
    if min(len(poses), len(lenses), len(sizes)) < 2:
        raise InputError(f"{path}: a calibration of Basalt for one camera; give that of a stereo pair")
    cameras = []
    for index in (0, 1):
        kind, values = str(lenses[index].get("camera_type")), lenses[index].get("intrinsics", {})
        if kind not in _BASALT_LENSES:
            raise InputError(
                f"{path}: the camera_type {kind[:40]!r} of camera {index} is not supported; calibrate with "
                f"{', '.join(_BASALT_LENSES)}"
            )
        model, names = _BASALT_LENSES[kind]
        q_wxyz = np.array([_number(path, poses[index], key) for key in ("qw", "qx", "qy", "qz")])
        p = np.array([_number(path, poses[index], key) for key in ("px", "py", "pz")])
        K = [_number(path, values, key) for key in ("fx", "fy", "cx", "cy")]
        lens = [_number(path, values, key) for key in names]
        X_BC = make_pose(matrix_from_wxyz(q_wxyz / np.linalg.norm(q_wxyz)), p)
        cameras.append(camera_of(f"{path} camera {index}", K, model, lens, X_BC, sizes[index]))
    return Rig(cameras[0], cameras[1])


def _number(path: Path, content: dict[str, Any], key: str) -> float:
    return float(numbers_at(path, content, key, (1,))[0])
