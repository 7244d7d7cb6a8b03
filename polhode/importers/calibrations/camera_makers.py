"""Calibrations that camera makers deliver: ZED (SN*.conf) and OAK (JSON of DepthAI).

ZED states the cameras for each size of image; the rotation vector (RX, CV, RZ) turns points of the left
camera into the right one, and the right camera is at (Baseline, TY, TZ) [mm] before that turn, as
Stereolabs' sample rectifies. DepthAI states each camera in another one, in centimetres.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.tables import numbers_at
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.importers.calibrations.rig import (
    EQUIDISTANT,
    RADIAL_TANGENTIAL,
    Camera,
    Rig,
    camera_of,
    pose_from_inverse,
)
from polhode.runtime.errors import InputError

SizeOfImages = Callable[[], tuple[int, int]]
"""Width and height of the images that a calibration is for [px]"""
ZED_SIZES = {
    (2208, 1242): "2K", (1920, 1080): "FHD", (1920, 1200): "FHD1200", (1280, 720): "HD", (960, 600): "SVGA",
    (672, 376): "VGA",
}  # fmt: skip
DEPTHAI_KINDS = {0: RADIAL_TANGENTIAL, 1: EQUIDISTANT}
"""cameraType: perspective, fisheye"""


def is_zed(content: Mapping[str, Any]) -> bool:
    """Whether this is a file of the ZED."""
    return any(name.startswith("LEFT_CAM_") for name in content)


def read_zed(path: Path, content: dict[str, Any], size_of_images: SizeOfImages) -> Rig:
    """The rig for images of a size. Raises InputError for sizes that the ZED has not."""
    size_px = size_of_images()
    name = ZED_SIZES.get(size_px)
    if name is None or f"LEFT_CAM_{name}" not in content:
        known = ", ".join(f"{w}x{h}" for (w, h), each in ZED_SIZES.items() if f"LEFT_CAM_{each}" in content)
        raise InputError(
            f"{path}: a calibration of the ZED for images of {known} px, but they have "
            f"{size_px[0]}x{size_px[1]}; give the calibration of these images"
        )
    stereo = {key.lower(): value for key, value in dict(content.get("STEREO", {})).items()}

    def stated(key: str) -> float:
        found = next((each for each in (f"{key}_{name}".lower(), key.lower()) if each in stereo), None)
        if found is None:
            raise InputError(f"{path} lacks {key}_{name} in [STEREO]; give the whole file of the ZED")
        return float(numbers_at(path, stereo, found, (1,))[0])

    R = np.asarray(exp_so3(np.array([stated("RX"), stated("CV"), stated("RZ")])))
    t = -1e-3 * np.array([stated("Baseline"), stated("TY"), stated("TZ")])
    X_01 = pose_from_inverse(make_pose(R, t))
    left, right = (
        _zed_camera(path, f"{side}_CAM_{name}", content, X, size_px)
        for side, X in (("LEFT", np.eye(4)), ("RIGHT", X_01))
    )
    return Rig(left, right)


def _zed_camera(
    path: Path, section: str, content: dict[str, Any], X_BC: Array, size_px: tuple[int, int]
) -> Camera:
    values = {key.lower(): value for key, value in dict(content.get(section, {})).items()}
    K = [numbers_at(path, values, key, (1,))[0] for key in ("fx", "fy", "cx", "cy")]
    lens = [
        float(numbers_at(path, values, key, (1,))[0]) if key in values else 0.0
        for key in ("k1", "k2", "p1", "p2", "k3")
    ]
    return camera_of(f"{path} [{section}]", K, RADIAL_TANGENTIAL, lens, X_BC, size_px)


def is_depthai(content: Mapping[str, Any]) -> bool:
    """Whether this is a calibration of DepthAI."""
    return isinstance(content.get("cameraData"), list)


def read_depthai(path: Path, content: dict[str, Any]) -> Rig:
    """The stereo pair of an OAK. Raises InputError where it has none."""
    cameras = {}
    for entry in content["cameraData"]:
        if isinstance(entry, list) and len(entry) == 2 and isinstance(entry[1], dict):
            cameras[int(entry[0])] = entry[1]
    named = content.get("stereoRectificationData")
    named = named if isinstance(named, dict) else {}
    left, right = (int(named.get(f"{side}CameraSocket", -1)) for side in ("left", "right"))
    if left not in cameras or right not in cameras:
        left, right = 1, 2
    if left not in cameras or right not in cameras:
        raise InputError(f"{path}: a calibration of DepthAI without a stereo pair; give that of both cameras")
    X_01 = _between(path, cameras, left, right)
    return Rig(
        _depthai_camera(path, cameras[left], left, np.eye(4)),
        _depthai_camera(path, cameras[right], right, X_01),
    )


def _between(path: Path, cameras: dict[int, dict[str, Any]], left: int, right: int) -> Array:
    """(4, 4) the right camera in the left one, by the chain of extrinsics."""
    poses: dict[int, Array] = {left: np.eye(4)}
    for _ in cameras:
        for socket, camera in cameras.items():
            stated = camera.get("extrinsics") or {}
            to = int(stated.get("toCameraSocket", -1))
            if to not in cameras or (socket in poses) == (to in poses):
                continue
            R = numbers_at(path, stated, "rotationMatrix", (9,)).reshape(3, 3)
            shift = stated.get("translation") or {}
            t_m = 0.01 * numbers_at(
                path, {"translation": [shift.get(k, 0.0) for k in "xyz"]}, "translation", (3,)
            )
            # turns points of this camera into the other one
            X_to = make_pose(R, t_m)
            if socket in poses:
                poses[to] = poses[socket] @ inverse_pose(X_to)
            else:
                poses[socket] = poses[to] @ X_to
    if right not in poses:
        raise InputError(
            f"{path}: nothing links the cameras {left} and {right}; give a calibration of the stereo pair"
        )
    return np.asarray(poses[right]) + 0.0


def _depthai_camera(path: Path, camera: dict[str, Any], socket: int, X_BC: Array) -> Camera:
    model = DEPTHAI_KINDS.get(int(camera.get("cameraType", 0)))
    if model is None:
        raise InputError(f"{path}: the cameraType of camera {socket} is not known; calibrate it again")
    lens = numbers_at(path, camera, "distortionCoeff", None).tolist()
    if model == EQUIDISTANT:
        lens = lens[:4]
    else:
        used = max((k + 1 for k, value in enumerate(lens) if value), default=0)
        lens = lens[: next(n for n in (4, 5, 8, 12, 14, len(lens)) if n >= used)]
    K = numbers_at(path, camera, "intrinsicMatrix", (9,)).reshape(3, 3)
    size = [int(numbers_at(path, camera, side, (1,))[0]) for side in ("width", "height")]
    return camera_of(f"{path} camera {socket}", K, model, lens, X_BC, size)
