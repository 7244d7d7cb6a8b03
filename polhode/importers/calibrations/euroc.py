"""``sensor.yaml`` of the two cameras of a dataset, as EuRoC publishes and ``polhode calibrate`` writes
them."""

from pathlib import Path

from polhode.files.tables import numbers_at, read_mapping
from polhode.importers.calibrations.rig import Camera, camera_of
from polhode.runtime.errors import InputError


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
