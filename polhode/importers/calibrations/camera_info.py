"""ROS camera_info, as two YAML files (camera_calibration), printed or as messages: K, D, R and P of each
camera.

K and D are of the image as recorded. R turns its camera into the rectified one, whose projection is P; the
fourth column of P, divided by its focal length, is where the left rectified camera is seen from the right
one: p_1 = R_1^T (R_0 p_0 + (P_1[0, 3] / P_1[0, 0], P_1[1, 3] / P_1[1, 1], 0)). Drivers leave R and P at 0, or
state the distance without its sign: both are read.
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
    """Whether the content of a file is a camera_info: a YAML file, or a message as ``topic echo`` prints
    it.
    """
    return _is_message(content) or (
        "camera_matrix" in content and ("projection_matrix" in content or "image_width" in content)
    )


def _is_message(content: dict[str, Any]) -> bool:
    return "distortion_model" in content and any({*names} <= content.keys() for names in ("KDRP", "kdrp"))


def read_camera_info(path: Path, content: dict[str, Any]) -> CameraInfo:
    """A YAML file of camera_calibration, or a printed message. Raises InputError for a wrong key."""
    if _is_message(content):
        K, D, R, P = "KDRP" if "K" in content else "kdrp"
        size, frame = ("width", "height"), content.get("header")
    else:
        K, D, R, P = (
            "camera_matrix", "distortion_coefficients", "rectification_matrix", "projection_matrix",
        )  # fmt: skip
        size, frame = ("image_width", "image_height"), None
    width, height = (int(numbers_at(path, content, side, (1,))[0]) for side in size)
    return CameraInfo(
        str(path),
        width,
        height,
        str(content.get("distortion_model", "plumb_bob")),
        tuple(numbers_at(path, content, D, (0, 4, 5, 8, 12, 14)).tolist()),
        numbers_at(path, content, K, (9,)).reshape(3, 3),
        numbers_at(path, content, R, (9,)).reshape(3, 3),
        numbers_at(path, content, P, (12,)).reshape(3, 4),
        str(frame.get("frame_id", "")) if isinstance(frame, dict) else "",
    )


def rig_of(infos: Sequence[CameraInfo], rectified: bool = False, X_01: Array | None = None) -> Rig:
    """The rig of a left and a right camera_info; B is the left camera.

    ``rectified``: the images are rectified ones. ``X_01``: the right camera in the left one, if frames of the
    recording give it. Raises InputError for numbers that are no calibration, and a right camera without
    baseline.
    """
    left, right = infos
    cameras = [read_one(info, rectified) for info in infos]
    remarks: tuple[str, ...] = ()
    if X_01 is None:
        offset = shift_between(infos)
        if not offset.any():
            raise InputError(f"{right.source}: {_why_no_shift(infos)}; give --calibration")
        if offset[0] > 0.0 and abs(offset[0]) > abs(offset[1]) and left.P[0, 3] < 0.0:
            raise InputError(
                f"{right.source}: by P this is the left camera of the pair; exchange left and right"
            )
        if offset[0] > 0.0 and abs(offset[0]) > abs(offset[1]):
            offset = offset * [-1.0, 1.0, 1.0]
            remarks = (
                f"{right.source}: Tx is positive in P, taken as the distance of the cameras; polhode "
                "checkout tells whether left and right are exchanged",
            )
        X_10 = make_pose(np.eye(3), offset)
        if not rectified:
            R_0, R_1 = (info.R if info.R.any() else np.eye(3) for info in infos)
            X_10 = make_pose(R_1.T @ R_0, R_1.T @ offset)
        X_01 = pose_from_inverse(X_10)
    return Rig(cameras[0], replace(cameras[1], X_BC=X_01), remarks=remarks)


def shift_between(infos: Sequence[CameraInfo]) -> Array:
    """(3,) where the left rectified camera is seen from the right one, by P; 0: it does not say."""
    left, right = (
        np.array([_quotient(P[0, 3], P[0, 0]), _quotient(P[1, 3], P[1, 1]), 0.0]) if P[0, 0] else np.zeros(3)
        for P in (info.P for info in infos)
    )
    return np.asarray(right - left)


def _why_no_shift(infos: Sequence[CameraInfo]) -> str:
    """Why the distance of the cameras is not stated."""
    Tx = float(infos[1].P[0, 3])
    if Tx:
        return (
            f"both cameras state the same fourth column of P, {Tx:.6g}, so that their distance is not known, "
            "and no tf_static links them"
        )
    what = "P is 0" if not infos[1].P.any() else "the fourth column of P is 0"
    return f"{what}, so the distance of the cameras is not stated, and no tf_static links them"


def read_one(info: CameraInfo, rectified: bool = False) -> Camera:
    """The camera of one camera_info, which is B itself. Raises InputError for numbers of no calibration."""
    numbers = np.concatenate([np.ravel(each) for each in (info.K, info.R, info.P, info.D)])
    if not np.isfinite(numbers).all():
        raise InputError(f"{info.source}: NaN or infinity in the calibration; calibrate the camera")
    if info.K[0, 0] <= 0.0 and info.P[0, 0] <= 0.0:
        raise InputError(
            f"{info.source}: a focal length of 0: this camera was not calibrated; give --calibration"
        )
    size = (info.width_px, info.height_px)
    if info.K[0, 0] <= 0.0 or (rectified and info.P[0, 0] > 0.0):
        return camera_of(info.source, info.P[:, :3], UNDISTORTED, (), np.eye(4), size)
    return camera_of(info.source, info.K, info.model, info.D, np.eye(4), size)


def _quotient(product: float, factor: float) -> float:
    """The number whose product with ``factor`` rounds to ``product``; of several, the one with fewest
    digits."""
    near = product / factor
    trials = (near, np.nextafter(near, np.inf), np.nextafter(near, -np.inf))
    exact = [each for each in trials if each * factor == product]
    return float(min(exact, key=lambda each: len(repr(float(each))), default=near))
