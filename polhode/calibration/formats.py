"""The calibration in the formats of other programs, which ``polhode/importers/calibrations`` reads back.

Numbers have all their digits, so that what is read back is what was written; a pose that a format states
inversely, or in two parts as camera_info does, returns within rounding.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import yaml

from polhode.calibration.adjustment import RigState
from polhode.geometry.lie import Array, hat
from polhode.importers.calibrations.rig import (
    EQUIDISTANT,
    RADIAL_TANGENTIAL,
    Camera,
    Rig,
    pose_from_inverse,
    write_rig,
)
from polhode.records.calibration_prior import COVARIANCE_FILE, POSITION, TURN, CalibrationPrior

SENSORS = ("cam0/sensor.yaml", "cam1/sensor.yaml")
KALIBR, OPENCV = "camchain.yaml", "opencv.yaml"
CAMERA_INFO = ("camera_info_left.yaml", "camera_info_right.yaml")
FORMAT_FILES = (*SENSORS, COVARIANCE_FILE, KALIBR, OPENCV, *CAMERA_INFO)


def prior_of_adjustment(state: RigState, covariance: Array) -> CalibrationPrior:
    """In the parameters of a dataset; covariance (n, n) of the lenses, then of X_10 Exp(theta) and t.

    The right camera in the left one turns by -R_10 theta, and its place moves by p x theta - R_01 dt.
    """
    X_01 = pose_from_inverse(state.X_10)
    R_01, n = X_01[:3, :3], len(covariance) - 6
    J = np.eye(len(covariance))
    J[n:, n:] = 0.0
    J[n : n + 3, n : n + 3], J[n : n + 3, n + 3 :] = hat(X_01[:3, 3]), -R_01
    J[n + 3 :, n : n + 3] = -R_01.T
    names = [f"cam{i}.{name}" for i, lens in enumerate(state.lenses) for name in lens.names]
    pose = [f"cam1.{name}" for name in (*POSITION, *TURN)]
    return CalibrationPrior((*names, *pose), J @ covariance @ J.T, "the calibration")


def rig_of(state: RigState, sizes_px: tuple[tuple[int, int], tuple[int, int]], covariance: Array) -> Rig:
    """The rig on the body of the left camera; covariance: of the adjustment."""
    poses = (np.eye(4), pose_from_inverse(state.X_10))
    left, right = (
        Camera(
            "the calibration",
            (float(lens.values[0]), float(lens.values[1]), float(lens.values[2]), float(lens.values[3])),
            EQUIDISTANT if lens.is_fisheye else RADIAL_TANGENTIAL,
            tuple(lens.coefficients.tolist()),
            X_BC,
            size,
        )
        for lens, X_BC, size in zip(state.lenses, poses, sizes_px, strict=True)
    )
    return Rig(left, right, prior_of_adjustment(state, covariance))


def calibration_files(
    state: RigState, sizes_px: tuple[tuple[int, int], tuple[int, int]], covariance: Array
) -> dict[str, bytes]:
    """All files by name. OpenCV's cannot state a pinhole beside a fisheye, and is then left out."""
    rig = rig_of(state, sizes_px, covariance)
    with TemporaryDirectory() as folder:
        # sensor.yaml has a rate, which images of a board do not show and nothing reads
        write_rig(Path(folder), rig, 1.0)
        files = {name: (Path(folder) / name).read_bytes() for name in (*SENSORS, COVARIANCE_FILE)}
    files[KALIBR] = _yaml(_camchain(state, rig))
    if rig.left.model == rig.right.model:
        files[OPENCV] = _opencv(state, rig)
    return files | dict(zip(CAMERA_INFO, _camera_infos(state, rig), strict=True))


def _yaml(content: dict[str, object]) -> bytes:
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000).encode()


def _camchain(state: RigState, rig: Rig) -> dict[str, object]:
    """Kalibr's; its models have 4 coefficients of Brown, others are those of OpenCV in the same order."""
    cameras: dict[str, object] = {}
    for index, camera in enumerate(rig.cameras):
        assert camera.size_px is not None
        cameras[f"cam{index}"] = {
            "camera_model": "pinhole",
            "intrinsics": list(camera.intrinsics),
            "distortion_model": "equidistant" if camera.model == EQUIDISTANT else "radtan",
            "distortion_coeffs": list(camera.distortion),
            **({"T_cn_cnm1": (state.X_10 + 0.0).tolist()} if index else {}),
            "resolution": list(camera.size_px),
            "cam_overlaps": [1 - index],
        }
    return cameras


def _opencv(state: RigState, rig: Rig) -> bytes:
    """FileStorage's YAML with the names of OpenCV's sample; T in metres."""
    store = cv2.FileStorage(".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    store.write("distortion_model", rig.left.model)
    for index, (camera, lens) in enumerate(zip(rig.cameras, state.lenses, strict=True), start=1):
        assert camera.size_px is not None
        store.write(f"M{index}", lens.K)
        store.write(f"D{index}", lens.coefficients[None])
        store.write(f"image_size_{index}", np.array([camera.size_px], dtype=np.int32))
    store.write("R", np.ascontiguousarray(state.X_10[:3, :3]))
    store.write("T", np.ascontiguousarray(state.X_10[:3, 3:]))
    return str(store.releaseAndGetString()).encode()


def rectifying_rotations(X_10: Array) -> tuple[Array, Array]:
    """Rotations (3, 3) of the left and the right camera into the rectified ones.

    Their x axis is the baseline, or their y axis, where the cameras stand one above the other.
    """
    R_10, t_10 = X_10[:3, :3], X_10[:3, 3]
    # from the left camera to the right one, in the left camera
    along = -R_10.T @ t_10
    along /= np.linalg.norm(along)
    forward = np.array([0.0, 0.0, 1.0]) + R_10[2]
    # the axis along the baseline, and the one that completes it to a right-handed frame with the third
    first = int(abs(along[1]) > abs(along[0]))
    axis = along * np.sign(along[first])
    other = np.cross(axis, forward) if first else np.cross(forward, axis)
    other /= np.linalg.norm(other)
    third = np.cross(other, axis) if first else np.cross(axis, other)
    R_left = np.stack([other, axis, third] if first else [axis, other, third])
    return R_left, R_left @ R_10.T


def _camera_infos(state: RigState, rig: Rig) -> list[bytes]:
    """ROS camera_info of both cameras, as camera_calibration writes them; P of the rectified pair."""
    R = rectifying_rotations(state.X_10)
    offset = R[1] @ state.X_10[:3, 3]
    focal = float(np.mean([camera.intrinsics[:2] for camera in rig.cameras]))
    out = []
    for index, camera in enumerate(rig.cameras):
        assert camera.size_px is not None
        width, height = camera.size_px
        P = np.diag([focal, focal, 1.0]) @ np.eye(3, 4)
        P[0, 2], P[1, 2] = 0.5 * (width - 1), 0.5 * (height - 1)
        if index:
            P[:2, 3] = focal * offset[:2]
        model = "plumb_bob" if len(camera.distortion) == 5 else "rational_polynomial"
        content: dict[str, object] = {
            "image_width": width,
            "image_height": height,
            "camera_name": ("left", "right")[index],
            "camera_matrix": _matrix(state.lenses[index].K),
            "distortion_model": "equidistant" if camera.model == EQUIDISTANT else model,
            "distortion_coefficients": _matrix(np.array([camera.distortion])),
            "rectification_matrix": _matrix(R[index]),
            "projection_matrix": _matrix(P),
        }
        out.append(_yaml(content))
    return out


def _matrix(values: Array) -> dict[str, object]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": (values + 0.0).ravel().tolist()}
