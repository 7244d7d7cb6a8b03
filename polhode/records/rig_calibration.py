"""The calibration of a stereo rig, read from the two ``sensor.yaml`` of a sequence (EuRoC's keys)."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from polhode.files.images import MAX_PIXELS
from polhode.files.tables import numbers_at, read_mapping
from polhode.geometry.lie import Array, make_pose
from polhode.runtime.errors import InputError

RADIAL_TANGENTIAL = ("radial-tangential", "radtan", "plumb_bob")
EQUIDISTANT = ("equidistant", "fisheye", "kannala-brandt")
UNDISTORTED = ("none",)
MIN_BASELINE_M = 1e-4
MAX_OFFSET_M = 1e4
"""Largest baseline, and coordinate of a camera in its body."""
MIN_SIDE_PX, MAX_SIDE_PX = 16, 32_000
"""OpenCV resamples images of up to 32767 px a side."""
MIN_FOCAL, MAX_FOCAL = 0.02, 1e4
"""Focal length over the larger side: fields of view from 175 degrees to 20 seconds of arc."""
MAX_ASPECT = 10.0
"""Of a pixel."""
MAX_CENTRE = 10.0
"""Distance of the principal point from the middle of the image, over its side; a part read out of a larger
sensor may lie beside it."""


@dataclass(frozen=True)
class StereoCalibration:
    """Two cameras on one body B: pinholes with radial-tangential distortion, or equidistant fisheyes.

    Pixel centres are integers.
    """

    K0: Array
    """(3, 3) intrinsic matrix of the left camera [px]"""
    K1: Array
    """(3, 3) of the right camera [px]"""
    dist0: Array
    """(n,) coefficients k1, k2, p1, p2[, k3, ...] in OpenCV's order, n in 4, 5, 8, 12, 14; (4,) k1 to k4 of a
    fisheye"""
    dist1: Array
    X_BC0: Array
    """(4, 4) pose of the left camera in the inspector's body"""
    X_BC1: Array
    """(4, 4) pose of the right camera"""
    width_px: int
    """Of the left image"""
    height_px: int
    bits: int | None = None
    """Depth of 16-bit image files, 8 to 16; None: not stated"""
    fisheye0: bool = False
    """Whether the left lens is an equidistant fisheye (polhode/geometry/fisheye.py)"""
    fisheye1: bool = False
    right_size_px: tuple[int, int] | None = None
    """Width and height of the right image; None: those of the left one"""

    def size_px(self, camera: int) -> tuple[int, int]:
        """Width and height of the images of a camera, 0 (left) or 1 (right)."""
        return self.right_size_px if camera and self.right_size_px else (self.width_px, self.height_px)


def read_calibration(mav0: Path, names: tuple[str, str] = ("cam0", "cam1")) -> StereoCalibration:
    """Read the ``sensor.yaml`` of the left and the right camera, folders of these names below ``mav0``.

    Raises InputError when a file or key is missing, a value is NaN, T_BS is not a rigid transform, the
    cameras coincide, or their ``bits`` differ.
    """
    left, right = (_read_camera(mav0 / name / "sensor.yaml") for name in names)
    X_BC0, X_BC1, bits, bits1 = left.X_BC, right.X_BC, left.bits, right.bits
    both = " and ".join(names)
    baseline_m = float(np.linalg.norm(X_BC1[:3, 3] - X_BC0[:3, 3]))
    if baseline_m > MAX_OFFSET_M:
        raise InputError(
            f"{mav0}: {both} are {baseline_m:g} m apart, above {MAX_OFFSET_M:g}; correct their T_BS"
        )
    if baseline_m < MIN_BASELINE_M:
        raise InputError(f"{mav0}: {both} coincide (baseline {baseline_m:g} m); check their T_BS")
    if bits != bits1:
        raise InputError(f"{mav0}: 'bits' of {both} differ, {bits} and {bits1}; correct one")
    return StereoCalibration(
        left.K,
        right.K,
        left.dist,
        right.dist,
        X_BC0,
        X_BC1,
        *left.size_px,
        bits,
        left.fisheye,
        right.fisheye,
        None if left.size_px == right.size_px else right.size_px,
    )


def read_range_calibration(mav0: Path, name: str = "cam0") -> StereoCalibration:
    """The ``sensor.yaml`` of the only camera, with a virtual right camera like it, for range images.

    Its distance, here 1 m, is to be set by ``with_baseline``. Raises InputError as ``read_calibration``.
    """
    camera = _read_camera(mav0 / name / "sensor.yaml")
    alone = StereoCalibration(
        camera.K,
        camera.K,
        camera.dist,
        camera.dist,
        camera.X_BC,
        camera.X_BC,
        *camera.size_px,
        camera.bits,
        camera.fisheye,
        camera.fisheye,
    )
    return with_baseline(alone, 1.0)


def with_baseline(calibration: StereoCalibration, baseline_m: float) -> StereoCalibration:
    """The calibration with the right camera beside the left one, parallel to it, along its rows."""
    X_C0C1 = make_pose(np.eye(3), np.array([baseline_m, 0.0, 0.0]))
    return replace(calibration, X_BC1=calibration.X_BC0 @ X_C0C1)


def read_camera_pose(path: Path) -> Array:
    """X_BC (4, 4), the T_BS of one ``sensor.yaml``. Raises InputError as ``read_calibration``."""
    return _read_camera(path).X_BC


@dataclass(frozen=True)
class _Camera:
    """One ``sensor.yaml``."""

    K: Array
    dist: Array
    fisheye: bool
    X_BC: Array
    size_px: tuple[int, int]
    bits: int | None


def _read_camera(path: Path) -> _Camera:
    sensor = read_mapping(path, "a camera needs its calibration (see docs/dataset.md)")
    model = sensor.get("camera_model", "pinhole")
    if model != "pinhole":
        raise InputError(f"{path} key 'camera_model': {_shown(model)} is not supported; use pinhole")
    resolution = numbers_at(path, sensor, "resolution", (2,))
    if (resolution < 1).any() or (resolution != np.round(resolution)).any():
        raise InputError(f"{path} key 'resolution': expected [width, height] in whole pixels")
    width, height = resolution
    if min(width, height) < MIN_SIDE_PX or max(width, height) > MAX_SIDE_PX or width * height > MAX_PIXELS:
        raise InputError(
            f"{path} key 'resolution': {width:g}x{height:g} px; sides may have {MIN_SIDE_PX} "
            f"to {MAX_SIDE_PX}, the image {MAX_PIXELS // 10**6} million"
        )
    fu, fv, cu, cv = numbers_at(path, sensor, "intrinsics", (4,))
    _require_pinhole(path, (fu, fv), (cu, cv), (width, height))
    K = np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])
    dist, fisheye = _distortion(path, sensor)
    X_BC = _rigid_transform(path, numbers_at(path, sensor, "T_BS", (16,)).reshape(4, 4))
    bits = sensor.get("bits")
    if bits is not None and (type(bits) is not int or not 8 <= bits <= 16):
        raise InputError(f"{path} key 'bits': expected the depth of the images, 8 to 16, got {_shown(bits)}")
    return _Camera(K, dist, fisheye, X_BC, (int(resolution[0]), int(resolution[1])), bits)


def _require_pinhole(
    path: Path, focal: tuple[float, float], centre: tuple[float, float], size: tuple[float, float]
) -> None:
    """Raise InputError for intrinsics [px] that no lens has with images of this size [px]."""
    fu, fv = focal
    if fu <= 0.0 or fv <= 0.0:
        raise InputError(f"{path} key 'intrinsics': focal lengths must be positive, got {fu:g} and {fv:g}")
    low, high = MIN_FOCAL * max(size), MAX_FOCAL * max(size)
    if not all(low <= f <= high for f in focal):
        raise InputError(
            f"{path} key 'intrinsics': focal lengths {fu:g} and {fv:g}, expected {low:g} to {high:g} px for "
            f"images of {size[0]:g}x{size[1]:g}"
        )
    if max(focal) > MAX_ASPECT * min(focal):
        raise InputError(
            f"{path} key 'intrinsics': focal lengths {fu:g} and {fv:g} differ by more than a factor of "
            f"{MAX_ASPECT:g}; correct one"
        )
    if any(abs(c - 0.5 * side) > MAX_CENTRE * side for c, side in zip(centre, size, strict=True)):
        raise InputError(
            f"{path} key 'intrinsics': the principal point ({centre[0]:g}, {centre[1]:g}) is more than "
            f"{MAX_CENTRE:g} images away from the image; give it in pixels"
        )


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _distortion(path: Path, sensor: dict[str, object]) -> tuple[Array, bool]:
    """The coefficients, and whether they are those of a fisheye."""
    if "distortion_model" not in sensor:
        raise InputError(
            f"{path} lacks the key 'distortion_model'; give radial-tangential, equidistant (a fisheye), or "
            "none for undistorted images"
        )
    model = str(sensor["distortion_model"]).lower()
    # YAML reads a bare `null` or `~` as None: the same intent as `none`.
    if model in UNDISTORTED:
        return np.zeros(4), False
    fisheye = model in EQUIDISTANT
    if not fisheye and model not in RADIAL_TANGENTIAL:
        valid = ", ".join((*RADIAL_TANGENTIAL, *EQUIDISTANT, *UNDISTORTED))
        raise InputError(
            f"{path} key 'distortion_model': {_shown(model)} is not supported; choose one of {valid}"
        )
    counts = (4,) if fisheye else (4, 5, 8, 12, 14)
    coefficients = numbers_at(path, sensor, "distortion_coefficients", counts)
    largest = abs(coefficients).max()
    # the highest order of a long lens reaches thousands
    if largest > 1e7:
        raise InputError(f"{path} key 'distortion_coefficients': {largest:g} is above {1e7:g}; correct it")
    return coefficients, fisheye


def _rigid_transform(path: Path, X: Array) -> Array:
    """The nearest rigid transform; only rounding in the file is accepted."""
    if abs(X).max() > MAX_OFFSET_M:
        raise InputError(
            f"{path} key 'T_BS': {abs(X).max():g} is above {MAX_OFFSET_M:g}; give the pose in metres"
        )
    R = X[:3, :3]
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    last_row_off = float(np.abs(X[3] - [0.0, 0.0, 0.0, 1.0]).max())
    if off > 1e-2 or np.linalg.det(R) < 0.0 or last_row_off > 1e-6:
        raise InputError(
            f"{path} key 'T_BS': not a rigid transform (row-major 4x4 with a rotation); correct it"
        )
    U, _, Vt = np.linalg.svd(R)
    return make_pose(U @ Vt, X[:3, 3])
