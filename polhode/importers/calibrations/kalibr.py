"""The camchain of Kalibr: cam0 is the left camera, cam1 the right one.

T_cn_cnm1 turns points of the camera before into this one. With T_cam_imu the body B is the IMU, whose poses
an estimator states; without it, the left camera.
"""

from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.tables import numbers_at
from polhode.geometry.lie import Array
from polhode.importers.calibrations.rig import Camera, camera_of, pose_from_inverse
from polhode.runtime.errors import InputError


def is_kalibr(content: dict[str, Any]) -> bool:
    """Whether the content of a YAML file is a camchain."""
    cameras = [value for key, value in content.items() if key.startswith("cam") and isinstance(value, dict)]
    return any("intrinsics" in camera and "T_BS" not in camera for camera in cameras)


def read_kalibr(path: Path, content: dict[str, Any], stereo: bool) -> list[Camera]:
    """Both cameras of a camchain, or cam0 alone. Raises InputError when a key is missing or wrong."""
    needed = {"cam0": "cam0 (left)", "cam1": "cam1 (right)"} if stereo else {"cam0": "cam0"}
    for name in needed:
        if not isinstance(content.get(name), dict):
            raise InputError(f"{path} lacks {name}: give a camchain with {' and '.join(needed.values())}")
    left = content["cam0"]
    X_BC = (
        pose_from_inverse(_transform(path, left, "T_cam_imu", "cam0")) if "T_cam_imu" in left else np.eye(4)
    )
    cameras = []
    for name in needed:
        camera, source = content[name], f"{path} {name}"
        if name == "cam1":
            X_BC = X_BC @ pose_from_inverse(_transform(path, camera, "T_cn_cnm1", name)) + 0.0
        if (model := camera.get("camera_model", "pinhole")) != "pinhole":
            raise InputError(
                f"{source}: camera_model {str(model)[:40]!r} is not supported; calibrate as pinhole"
            )
        cameras.append(
            camera_of(
                source,
                numbers_at(path, camera, "intrinsics", (4,)),
                str(camera.get("distortion_model", "none")),
                numbers_at(path, camera, "distortion_coeffs", (0, 4, 5, 8)),
                X_BC,
                numbers_at(path, camera, "resolution", (2,)).tolist(),
            )
        )
    return cameras


def _transform(path: Path, camera: dict[str, Any], key: str, name: str) -> Array:
    if key not in camera:
        raise InputError(f"{path} {name} lacks {key}: give the camchain of a calibrated pair")
    return numbers_at(path, camera, key, (16,)).reshape(4, 4)
