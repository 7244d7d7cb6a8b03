"""Which format a calibration has, and the rig in it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from polhode.files.foreign_files import CONFIGURATION_BYTES, MissingFile, read_text
from polhode.files.yaml_files import parse_yaml
from polhode.importers.calibrations.camera_info import camera_of, is_camera_info, read_camera_info, rig_of
from polhode.importers.calibrations.euroc import read_euroc, read_euroc_camera
from polhode.importers.calibrations.kalibr import is_kalibr, read_kalibr, read_kalibr_camera
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
    text = _text(path, CAMERA_KINDS)
    if is_opencv(text):
        return read_opencv_camera(path)
    content = _content(path, text, CAMERA_KINDS)
    if is_kalibr(content):
        return read_kalibr_camera(path, content)
    if is_camera_info(content) and "projection_matrix" in content:
        return camera_of(read_camera_info(path, content))
    return read_opencv_camera(path)


def read_rig(paths: Sequence[Path], unit_m: float = 1.0) -> Rig:
    """The rig of a file, two files or a folder, of any known format.

    ``unit_m``: unit of OpenCV's T [m], which is that of the board's squares. Raises InputError for what is
    missing, of no known format, or wrong.
    """
    if len(paths) == 1 and paths[0].is_dir():
        return read_euroc(paths[0])
    if not 1 <= len(paths) <= 2:
        raise InputError(f"--calibration: {len(paths)} were given; give {KINDS}")
    texts = [_text(path, KINDS) for path in paths]
    if any(is_opencv(text) for text in texts):
        return read_opencv(paths, unit_m)
    contents = [_content(path, text, KINDS) for path, text in zip(paths, texts, strict=True)]
    if len(paths) == 1 and is_kalibr(contents[0]):
        return read_kalibr(paths[0], contents[0])
    if all(is_camera_info(content) for content in contents):
        if len(paths) == 1:
            raise InputError(f"{paths[0]}: the camera_info of one camera; give those of both: LEFT RIGHT")
        return rig_of(
            [read_camera_info(path, content) for path, content in zip(paths, contents, strict=True)]
        )
    return read_opencv(paths, unit_m)


def _text(path: Path, kinds: str) -> str:
    try:
        return read_text(path, CONFIGURATION_BYTES, "a calibration")
    except MissingFile:
        raise InputError(f"{path} is missing: give {kinds}") from None


def _content(path: Path, text: str, kinds: str) -> dict[str, Any]:
    content = parse_yaml(text, str(path))
    if not isinstance(content, dict):
        raise InputError(f"{path} is no calibration: give {kinds}")
    return content
