"""Which format a calibration has, and the rig in it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from polhode.files.foreign_files import CONFIGURATION_BYTES, MissingFile, read_text
from polhode.files.yaml_files import parse_yaml
from polhode.importers.calibrations.camera_info import is_camera_info, read_camera_info, read_one, rig_of
from polhode.importers.calibrations.euroc import read_euroc_camera
from polhode.importers.calibrations.kalibr import is_kalibr, read_kalibr
from polhode.importers.calibrations.opencv import is_opencv, read_opencv, read_opencv_camera
from polhode.importers.calibrations.rig import Camera, Rig
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
    if content is not None and is_kalibr(content):
        return read_kalibr(path, content, stereo=False)[0]
    if content is not None and is_camera_info(content) and "projection_matrix" in content:
        return read_one(read_camera_info(path, content))
    return read_opencv_camera(path)


def read_rig(paths: Sequence[Path], unit_m: float = 1.0) -> Rig:
    """The rig of a file, two files or a folder, of any known format.

    ``unit_m``: unit of OpenCV's T [m], which is that of the board's squares. Raises InputError for what is
    missing, of no known format, or wrong.
    """
    if len(paths) == 1 and paths[0].is_dir():
        return Rig(read_euroc_camera(paths[0], "cam0"), read_euroc_camera(paths[0], "cam1"))
    if not 1 <= len(paths) <= 2:
        raise InputError(f"--calibration: {len(paths)} were given; give {KINDS}")
    contents = [content for path in paths if (content := _content(path, KINDS)) is not None]
    if len(contents) == len(paths):
        if len(paths) == 1 and is_kalibr(contents[0]):
            return Rig(*read_kalibr(paths[0], contents[0], stereo=True))
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
