"""Which format a calibration has, and the rig in it.

``sensor.yaml`` of both cameras is as EuRoC publishes and ``polhode calibrate`` writes it; the other formats
have modules of their own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from polhode.files.tables import numbers_at, read_mapping
from polhode.importers.calibrations.camera_info import is_camera_info, read_camera_info, read_one, rig_of
from polhode.importers.calibrations.camera_makers import (
    SizeOfImages,
    is_depthai,
    is_zed,
    read_depthai,
    read_zed,
)
from polhode.importers.calibrations.content import read_content
from polhode.importers.calibrations.datasets import is_colmap, is_kitti, read_colmap, read_kitti
from polhode.importers.calibrations.kalibr import is_kalibr, read_kalibr
from polhode.importers.calibrations.opencv import is_opencv, read_opencv, read_opencv_camera
from polhode.importers.calibrations.rig import Camera, Rig, camera_of
from polhode.importers.calibrations.slam_programs import (
    is_basalt,
    is_orb_slam,
    is_vins,
    read_basalt,
    read_orb_slam,
    read_vins,
)
from polhode.records.calibration_prior import DISTORTION, states_sigmas
from polhode.records.rig_calibration import read_calibration
from polhode.runtime.errors import InputError

KINDS = (
    "a file of OpenCV (YAML, XML, JSON, npz), a camchain of Kalibr, two camera_info of ROS (left, right), "
    "settings of ORB-SLAM, VINS-Fusion or Basalt, a file of ZED, OAK or KITTI, a model of COLMAP, or a "
    "folder with cam0/sensor.yaml and cam1/sensor.yaml"
)
CAMERA_KINDS = (
    "a file of OpenCV (YAML, XML, JSON, npz), a camchain of Kalibr, a camera_info of ROS, or a folder with "
    "cam0/sensor.yaml"
)
PROGRAMS = (
    (is_orb_slam, read_orb_slam), (is_vins, read_vins), (is_basalt, read_basalt), (is_depthai, read_depthai),
)  # fmt: skip
"""Whether a file is of a program, and what reads its rig"""
OTHERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Metashape (Agisoft)", ("document", "calibration")),
    ("MATLAB's stereoParams", ("CameraParameters1",)),
    ("nerfstudio or instant-ngp (transforms.json)", ("camera_angle_x", "fl_x")),
    ("OpenMVG (sfm_data.json)", ("sfm_data_version",)),
    ("calib.io", ("Calibration",)),
    ("Blender or BlenderProc", ("cam_K", "cam_K_matrix")),
    ("AirSim (settings.json)", ("SettingsVersion",)),
    (
        "RealSense Viewer, which has no calibration in it",
        ("controls-depth-white-balance-auto", "schema version"),
    ),
)
"""Formats that are not read, by keys that they alone have"""


def _no_size() -> tuple[int, int]:
    raise InputError("the calibration is of several image sizes: give it with the images to polhode import")


def read_camera(paths: Sequence[Path]) -> Camera:
    """One camera, by a file or a folder of any known format.

    Raises InputError for what is missing, of no known format, or wrong.
    """
    if len(paths) != 1:
        raise InputError(f"--calibration: {len(paths)} were given for one camera; give {CAMERA_KINDS}")
    path = paths[0]
    if path.is_dir():
        return read_euroc_camera(path)
    content = read_content(path, CAMERA_KINDS)
    if is_kalibr(content):
        return read_kalibr(path, content, stereo=False)[0]
    # a file of OpenCV, too, has camera_matrix and image_width
    if is_camera_info(content) and not content.keys().isdisjoint(("projection_matrix", "P", "p")):
        return read_one(read_camera_info(path, content))
    if _is_sensor(content):
        return _sensor(path, content)
    _refuse_others(path, content, CAMERA_KINDS)
    return read_opencv_camera(path, content)


def read_rig(
    paths: Sequence[Path], size_of_images: SizeOfImages = _no_size, cameras: tuple[int, int] = (0, 1)
) -> Rig:
    """The rig of a file, two files or a folder, of any known format, with the lengths that it states.

    size_of_images: for formats that state several sizes; cameras: those of KITTI. Raises InputError for what
    is missing, of no known format, or wrong.
    """
    if len(paths) == 1 and paths[0].is_dir():
        return read_colmap(paths[0]) if is_colmap(paths[0]) else read_euroc_rig(paths[0])
    if not 1 <= len(paths) <= 2:
        raise InputError(f"--calibration: {len(paths)} were given; give {KINDS}")
    contents = {path: read_content(path, KINDS) for path in paths}
    if len(paths) == 1:
        path, content = next(iter(contents.items()))
        if is_kalibr(content):
            left, right = read_kalibr(path, content, stereo=True)
            return Rig(left, right)
        for is_it, read in PROGRAMS:
            if is_it(content):
                return read(path, content)
        if is_zed(content):
            return read_zed(path, content, size_of_images)
        if is_kitti(content):
            return read_kitti(path, content, size_of_images, cameras)
    if all(is_camera_info(content) for content in contents.values()):
        if len(paths) == 1:
            raise InputError(f"{paths[0]}: the camera_info of one camera; give those of both: LEFT RIGHT")
        return rig_of([read_camera_info(path, content) for path, content in contents.items()])
    if all(_is_sensor(content) for content in contents.values()):
        if len(paths) == 1:
            raise InputError(f"{paths[0]}: the sensor.yaml of one camera; give those of both: LEFT RIGHT")
        left, right = (_sensor(path, content) for path, content in contents.items())
        return Rig(left, right)
    for path, content in contents.items():
        _refuse_others(path, content, KINDS)
        if not is_opencv(content):
            raise InputError(f"{path}: of no format that is read; give {KINDS}")
    return read_opencv(contents)


def _refuse_others(path: Path, content: Mapping[str, Any], kinds: str) -> None:
    """Raise InputError for a format that is known, and not read."""
    for name, keys in OTHERS:
        if not content.keys().isdisjoint(keys):
            raise InputError(f"{path}: a file of {name}, whose format is not read; give {kinds}")


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
    return _sensor(
        path, read_mapping(path, "a camera needs its calibration; write it, or give --calibration to import")
    )


def _is_sensor(content: Mapping[str, Any]) -> bool:
    return "T_BS" in content and "intrinsics" in content


def _sensor(path: Path, sensor: dict[str, Any]) -> Camera:
    """The camera of a ``sensor.yaml``."""
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
