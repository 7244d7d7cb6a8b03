"""Which format a calibration has, and the rig in it; the formats of Kalibr and EuRoC.

A camchain of Kalibr has the left camera in cam0, the right one in cam1; T_cn_cnm1 turns points of the camera
before into this one. With T_cam_imu the body B is the IMU, whose poses an estimator states; without it, the
left camera. ``sensor.yaml`` of both cameras is as EuRoC publishes and ``polhode calibrate`` writes it.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.foreign_files import CONFIGURATION_BYTES, MissingFile, read_text
from polhode.files.tables import numbers_at, read_mapping
from polhode.files.yaml_files import parse_yaml
from polhode.importers.calibrations.camera_info import is_camera_info, read_camera_info, read_one, rig_of
from polhode.importers.calibrations.opencv import is_opencv, read_opencv, read_opencv_camera
from polhode.importers.calibrations.rig import Camera, Rig, camera_of, pose_from_inverse
from polhode.records.calibration_prior import DISTORTION, states_sigmas
from polhode.records.rig_calibration import read_calibration
from polhode.runtime.errors import InputError

KINDS = (
    "a YAML or JSON file of OpenCV, a camchain of Kalibr, two camera_info of ROS (left, right), or a "
    "folder with cam0/sensor.yaml and cam1/sensor.yaml"
)
CAMERA_KINDS = (
    "a YAML or JSON file of OpenCV, a camchain of Kalibr, a camera_info of ROS, or a folder with "
    "cam0/sensor.yaml"
)


def read_camera(paths: Sequence[Path]) -> Camera:
    """One camera, by a file or a folder of any known format.

    Raises InputError for what is missing, of no known format, or wrong.
    """
    if len(paths) != 1:
        raise InputError(f"--calibration: {len(paths)} were given for one camera; give {CAMERA_KINDS}")
    path = paths[0]
    if path.is_dir():
        return read_euroc_camera(path)
    content = _content(path, CAMERA_KINDS)
    if content is not None and _is_kalibr(content):
        return _read_kalibr(path, content, stereo=False)[0]
    if content is not None and is_camera_info(content) and "projection_matrix" in content:
        return read_one(read_camera_info(path, content))
    return read_opencv_camera(path)


def read_rig(paths: Sequence[Path], unit_m: float = 1.0) -> Rig:
    """The rig of a file, two files or a folder, of any known format.

    ``unit_m``: unit of OpenCV's T [m], which is that of the board's squares. Raises InputError for what is
    missing, of no known format, or wrong.
    """
    if len(paths) == 1 and paths[0].is_dir():
        return read_euroc_rig(paths[0])
    if not 1 <= len(paths) <= 2:
        raise InputError(f"--calibration: {len(paths)} were given; give {KINDS}")
    contents = [content for path in paths if (content := _content(path, KINDS)) is not None]
    if len(contents) == len(paths):
        if len(paths) == 1 and _is_kalibr(contents[0]):
            left, right = _read_kalibr(paths[0], contents[0], stereo=True)
            return Rig(left, right)
        if all(is_camera_info(content) for content in contents):
            if len(paths) == 1:
                raise InputError(f"{paths[0]}: the camera_info of one camera; give those of both: LEFT RIGHT")
            return rig_of([read_camera_info(*each) for each in zip(paths, contents, strict=True)])
    return read_opencv(paths, unit_m)


def _content(path: Path, kinds: str) -> dict[str, Any] | None:
    """The content of a YAML file; None: it is one of OpenCV."""
    try:
        text = read_text(path, CONFIGURATION_BYTES, "a calibration")
    except MissingFile:
        raise InputError(f"{path} is missing: give {kinds}") from None
    if is_opencv(text):
        return None
    content = parse_yaml(text, str(path))
    if not isinstance(content, dict):
        raise InputError(f"{path} is no calibration: give {kinds}")
    return content


def read_euroc_rig(folder: Path, names: tuple[str, str] = ("cam0", "cam1")) -> Rig:
    """Both cameras by ``sensor.yaml``, and how well they are known, if that is stated."""
    rig = Rig(read_euroc_camera(folder, names[0]), read_euroc_camera(folder, names[1]))
    base = folder / "mav0" if (folder / "mav0").is_dir() else folder
    prior = read_calibration(base, names).prior if states_sigmas(base, names) else None
    if prior is None:
        return rig
    # a coefficient of 0 at the end is left out
    kept = tuple(
        f"cam{i}.{name}" for i, each in enumerate(rig.cameras) for name in DISTORTION[: len(each.distortion)]
    )
    lost = [n for n in prior.names if n.partition(".")[2] in DISTORTION and n not in kept]
    return replace(rig, prior=prior.without(*lost) if lost else prior)


def read_euroc_camera(folder: Path, name: str = "cam0") -> Camera:
    """The camera of ``cam0/sensor.yaml`` in a folder, or below its mav0. ``name``: the camera's folder.

    Raises InputError when a file or key is missing or wrong.
    """
    base = folder / "mav0" if (folder / "mav0").is_dir() else folder
    path = base / name / "sensor.yaml"
    sensor = read_mapping(path, "a camera needs its calibration")
    if sensor.get("camera_model", "pinhole") != "pinhole":
        raise InputError(f"{path} key 'camera_model': only pinhole is supported")
    named, bits = sensor.get("distortion_model"), sensor.get("bits")
    return camera_of(
        str(path),
        numbers_at(path, sensor, "intrinsics", (4,)),
        str(named or "none"),
        numbers_at(path, sensor, "distortion_coefficients", None) if named else (),
        numbers_at(path, sensor, "T_BS", (16,)).reshape(4, 4),
        numbers_at(path, sensor, "resolution", (2,)).tolist(),
        bits if isinstance(bits, int) else None,
    )


def _is_kalibr(content: dict[str, Any]) -> bool:
    cameras = [value for key, value in content.items() if key.startswith("cam") and isinstance(value, dict)]
    return any("intrinsics" in camera and "T_BS" not in camera for camera in cameras)


def _read_kalibr(path: Path, content: dict[str, Any], stereo: bool) -> list[Camera]:
    """Both cameras of a camchain, or cam0 alone. Raises InputError when a key is missing or wrong."""
    needed = {"cam0": "cam0 (left)", "cam1": "cam1 (right)"} if stereo else {"cam0": "cam0"}
    X_BC, cameras = np.eye(4), []
    for name in needed:
        camera, source = content.get(name), f"{path} {name}"
        if not isinstance(camera, dict):
            raise InputError(f"{path} lacks {name}: give a camchain with {' and '.join(needed.values())}")
        key = "T_cam_imu" if name == "cam0" else "T_cn_cnm1"
        if key in camera:
            X = pose_from_inverse(numbers_at(path, camera, key, (16,)).reshape(4, 4))
            X_BC = X if name == "cam0" else X_BC @ X + 0.0
        elif name == "cam1":
            raise InputError(f"{source} lacks {key}: give the camchain of a calibrated pair")
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
