"""ROS camera_info, as two YAML files (camera_calibration) or as messages: K, D, R and P of each camera.

K and D are of the image as recorded. R turns its camera into the rectified one, whose projection is P; the
fourth column of P, divided by its focal length, is where the left rectified camera is seen from the right
one: p_1 = R_1^T (R_0 p_0 + (P_1[0, 3] / P_1[0, 0], P_1[1, 3] / P_1[1, 1], 0)).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.tables import numbers_at
from polhode.geometry.lie import Array, make_pose
from polhode.importers.calibrations.rig import UNDISTORTED, Camera, Rig, camera_of, pose_from_inverse
from polhode.runtime.errors import InputError


@dataclass(frozen=True)
class CameraInfo:
    """What one camera_info states."""

    source: str
    width_px: int
    height_px: int
    model: str
    D: tuple[float, ...]
    K: Array
    """(3, 3)"""
    R: Array
    """(3, 3) from the camera as recorded to the rectified one"""
    P: Array
    """(3, 4)"""
    frame: str = ""
    """Name of the camera's frame; empty: not stated"""


def is_camera_info(content: dict[str, Any]) -> bool:
    """Whether the content of a YAML file is a camera_info."""
    return "camera_matrix" in content and ("projection_matrix" in content or "image_width" in content)


def read_camera_info(path: Path, content: dict[str, Any]) -> CameraInfo:
    """A YAML file of camera_calibration. Raises InputError when a key is missing or wrong."""
    width, height = (int(numbers_at(path, content, f"image_{side}", (1,))[0]) for side in ("width", "height"))
    D = numbers_at(path, content, "distortion_coefficients", (0, 4, 5, 8, 12, 14))
    return CameraInfo(
        str(path),
        width,
        height,
        str(content.get("distortion_model", "plumb_bob")),
        tuple(D.tolist()),
        numbers_at(path, content, "camera_matrix", (9,)).reshape(3, 3),
        numbers_at(path, content, "rectification_matrix", (9,)).reshape(3, 3),
        numbers_at(path, content, "projection_matrix", (12,)).reshape(3, 4),
    )


def rig_of(infos: Sequence[CameraInfo], rectified: bool = False, X_01: Array | None = None) -> Rig:
    """The rig of a left and a right camera_info; B is the left camera.

    ``rectified``: the images are rectified ones. ``X_01``: the right camera in the left one, if frames of the
    recording give it. Raises InputError for numbers that are no calibration, and a right camera without
    baseline.
    """
    left, right = infos
    cameras = [read_one(info, rectified) for info in infos]
    if X_01 is None:
        other, offset = (
            np.array([_quotient(P[0, 3], P[0, 0]), _quotient(P[1, 3], P[1, 1]), 0.0])
            for P in (left.P, right.P)
        )
        if not np.any(offset != other):
            raise InputError(
                f"{right.source}: the fourth column of P is 0, so the distance of the cameras is not stated; "
                "calibrate them as a stereo pair, or give --calibration"
            )
        offset = offset - other
        if offset[0] > 0.0 and abs(offset[0]) > abs(offset[1]):
            raise InputError(
                f"{right.source}: by P this is the left camera of the pair; exchange left and right"
            )
        X_10 = make_pose(np.eye(3), offset)
        if not rectified:
            X_10 = make_pose(right.R.T @ left.R, right.R.T @ offset)
        X_01 = pose_from_inverse(X_10)
    return Rig(cameras[0], replace(cameras[1], X_BC=X_01))


def read_one(info: CameraInfo, rectified: bool = False) -> Camera:
    """The camera of one camera_info, which is B itself. Raises InputError for numbers of no calibration."""
    numbers = np.concatenate([np.ravel(each) for each in (info.K, info.R, info.P, info.D)])
    if not np.isfinite(numbers).all():
        raise InputError(f"{info.source}: NaN or infinity in the calibration; calibrate the camera")
    if info.K[0, 0] <= 0.0 or info.P[0, 0] <= 0.0:
        raise InputError(
            f"{info.source}: a focal length of 0: this camera was not calibrated; give --calibration"
        )
    size = (info.width_px, info.height_px)
    if rectified:
        return camera_of(info.source, info.P[:, :3], UNDISTORTED, (), np.eye(4), size)
    return camera_of(info.source, info.K, info.model, info.D, np.eye(4), size)


def _quotient(product: float, factor: float) -> float:
    """The number whose product with ``factor`` rounds to ``product``; of several, the one with fewest
    digits."""
    near = product / factor
    trials = (near, np.nextafter(near, np.inf), np.nextafter(near, -np.inf))
    exact = [each for each in trials if each * factor == product]
    return float(min(exact, key=lambda each: len(repr(float(each))), default=near))
