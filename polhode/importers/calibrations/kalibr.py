"""The camchain of Kalibr: cam0 is the left camera, cam1 the right one.

T_cn_cnm1 turns points of the camera before into this one. With T_cam_imu the body B is the IMU, whose poses
an estimator states; without it, the left camera.
"""

from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.tables import numbers_at
from polhode.geometry.lie import Array
from polhode.importers.calibrations.rig import Camera, Rig, distortion_of, pose_from_inverse
from polhode.runtime.errors import InputError


def is_kalibr(content: dict[str, Any]) -> bool:
    """Whether the content of a YAML file is a camchain."""
    cameras = [value for key, value in content.items() if key.startswith("cam") and isinstance(value, dict)]
    return any("intrinsics" in camera and "T_BS" not in camera for camera in cameras)


def read_kalibr(path: Path, content: dict[str, Any]) -> Rig:
    """The rig of a camchain. Raises InputError when a key is missing or wrong."""
    for name in ("cam0", "cam1"):
        if not isinstance(content.get(name), dict):
            raise InputError(f"{path} lacks {name}: a stereo rig needs cam0 (left) and cam1 (right)")
    X_BC0 = _left_pose(path, content["cam0"])
    X_10 = _transform(path, content["cam1"], "T_cn_cnm1", "cam1")
    X_BC1 = X_BC0 @ pose_from_inverse(X_10) + 0.0
    return Rig(_camera(path, content["cam0"], "cam0", X_BC0), _camera(path, content["cam1"], "cam1", X_BC1))


def read_kalibr_camera(path: Path, content: dict[str, Any]) -> Camera:
    """cam0 of a camchain alone. Raises InputError as ``read_kalibr``."""
    if not isinstance(content.get("cam0"), dict):
        raise InputError(f"{path} lacks cam0: give the camchain of the camera")
    return _camera(path, content["cam0"], "cam0", _left_pose(path, content["cam0"]))


def _left_pose(path: Path, camera: dict[str, Any]) -> Array:
    if "T_cam_imu" not in camera:
        return np.eye(4)
    return pose_from_inverse(_transform(path, camera, "T_cam_imu", "cam0"))


def _transform(path: Path, camera: dict[str, Any], key: str, name: str) -> Array:
    if key not in camera:
        raise InputError(f"{path} {name} lacks {key}: give the camchain of a calibrated pair")
    return numbers_at(path, camera, key, (16,)).reshape(4, 4)


def _camera(path: Path, camera: dict[str, Any], name: str, X_BC: Array) -> Camera:
    model = camera.get("camera_model", "pinhole")
    if model != "pinhole":
        raise InputError(
            f"{path} {name}: camera_model {str(model)[:40]!r} is not supported; calibrate as pinhole"
        )
    intrinsics = numbers_at(path, camera, "intrinsics", (4,))
    coefficients = numbers_at(path, camera, "distortion_coeffs", (0, 4, 5, 8))
    named, distortion = distortion_of(
        f"{path} {name}", str(camera.get("distortion_model", "none")), coefficients.tolist()
    )
    width, height = numbers_at(path, camera, "resolution", (2,))
    fu, fv, cu, cv = intrinsics.tolist()
    return Camera(
        f"{path} {name}",
        (fu, fv, cu, cv),
        named,
        distortion,
        X_BC,
        (int(width), int(height)),
    )
