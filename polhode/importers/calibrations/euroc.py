"""``sensor.yaml`` of the two cameras of a dataset, as EuRoC publishes and ``polhode calibrate`` writes
them."""

from pathlib import Path

from polhode.files.tables import numbers_at, read_mapping
from polhode.importers.calibrations.rig import Camera, Rig, distortion_of
from polhode.runtime.errors import InputError


def read_euroc(folder: Path, names: tuple[str, str] = ("cam0", "cam1")) -> Rig:
    """The rig of ``cam0/sensor.yaml`` and ``cam1/sensor.yaml`` in a folder, or below its mav0.

    ``names``: the folders of left and right camera.

    Raises InputError when a file or key is missing or wrong.
    """
    base = folder / "mav0" if (folder / "mav0").is_dir() else folder
    left, right = (_camera(base / name / "sensor.yaml") for name in names)
    return Rig(left, right)


def read_euroc_camera(folder: Path, name: str = "cam0") -> Camera:
    """The camera of ``cam0/sensor.yaml`` alone. Raises InputError as ``read_euroc``.

    ``name``: its folder.
    """
    base = folder / "mav0" if (folder / "mav0").is_dir() else folder
    return _camera(base / name / "sensor.yaml")


def _camera(path: Path) -> Camera:
    sensor = read_mapping(path, "a camera needs its calibration")
    if sensor.get("camera_model", "pinhole") != "pinhole":
        raise InputError(f"{path} key 'camera_model': only pinhole is supported")
    fu, fv, cu, cv = numbers_at(path, sensor, "intrinsics", (4,)).tolist()
    named = sensor.get("distortion_model")
    coefficients = numbers_at(path, sensor, "distortion_coefficients", None) if named else ()
    model, distortion = distortion_of(str(path), str(named or "none"), list(coefficients))
    width, height = numbers_at(path, sensor, "resolution", (2,))
    X_BC = numbers_at(path, sensor, "T_BS", (16,)).reshape(4, 4)
    bits = sensor.get("bits")
    return Camera(
        str(path),
        (fu, fv, cu, cv),
        model,
        distortion,
        X_BC,
        (int(width), int(height)),
        bits if isinstance(bits, int) else None,
    )
