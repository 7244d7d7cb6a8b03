"""Camchains of Kalibr, and of the programs that took its format over (OpenVINS, TUM-VI, Basalt's converter).

The left camera is cam0, the right one cam1; T_cn_cnm1 turns points of the camera before into this one. Beside
an IMU, T_cam_imu turns points of the IMU into the camera, T_imu_cam (OpenVINS) those of the camera into the
IMU, of one camera or of both; the body B is then the IMU, whose poses an estimator states.
"""

from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.tables import numbers_at
from polhode.geometry.lie import Array
from polhode.importers.calibrations.rig import Camera, camera_of, pose_from_inverse
from polhode.runtime.errors import InputError

_PINHOLE = ("pinhole", "pinhole-radtan", "pinhole-equi")


def is_kalibr(content: dict[str, Any]) -> bool:
    """Whether the content of a file is a camchain."""
    cameras = [value for key, value in content.items() if key.startswith("cam") and isinstance(value, dict)]
    return any("intrinsics" in camera and "T_BS" not in camera for camera in cameras)


def read_kalibr(path: Path, content: dict[str, Any], stereo: bool) -> list[Camera]:
    """Both cameras of a camchain, or cam0 alone. Raises InputError when a key is missing or wrong."""
    needed = {"cam0": "cam0 (left)", "cam1": "cam1 (right)"} if stereo else {"cam0": "cam0"}
    X_BC, cameras = np.eye(4), []
    for name in needed:
        camera, source = content.get(name), f"{path} {name}"
        if not isinstance(camera, dict):
            raise InputError(f"{path} lacks {name}: give a camchain with {' and '.join(needed.values())}")
        before = X_BC
        X_BC = _pose(path, camera, before)
        if name == "cam1" and "T_cn_cnm1" not in camera and X_BC is before:
            raise InputError(f"{source} lacks T_cn_cnm1: give the camchain of a calibrated pair")
        if (model := camera.get("camera_model", "pinhole")) not in _PINHOLE:
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


def _pose(path: Path, camera: dict[str, Any], X_BC_before: Array) -> Array:
    """(4, 4) of a camera in B, by its place beside the camera before or beside the IMU."""
    if "T_cn_cnm1" in camera:
        step = pose_from_inverse(numbers_at(path, camera, "T_cn_cnm1", (16,)).reshape(4, 4))
        return np.asarray(X_BC_before @ step + 0.0)
    if "T_imu_cam" in camera:
        return numbers_at(path, camera, "T_imu_cam", (16,)).reshape(4, 4) + 0.0
    if "T_cam_imu" in camera:
        return pose_from_inverse(numbers_at(path, camera, "T_cam_imu", (16,)).reshape(4, 4))
    return X_BC_before
