"""The calibration of a stereo rig, read from the two ``sensor.yaml`` of a sequence (EuRoC's keys)."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from polhode.files.images import MAX_PIXELS
from polhode.files.tables import numbers_at, read_mapping
from polhode.geometry.lie import Array, make_pose
from polhode.records.calibration_prior import CalibrationPrior, read_prior
from polhode.runtime.errors import InputError

RADIAL_TANGENTIAL = ("radial-tangential", "radtan", "plumb_bob")
EQUIDISTANT = ("equidistant", "fisheye", "kannala-brandt")
MIN_BASELINE_M = 1e-4
USUAL_BASELINES_M = 3e-3, 5.0
"""Of rigs; others are doubted, as of another unit"""
MAX_OFFSET_M = 1e4
"""Largest baseline, and coordinate of a camera in its body."""


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
    prior: CalibrationPrior | None = None
    """How well all of this is known; None: not stated (``calibration_prior.default_prior``)"""

    def size_px(self, camera: int) -> tuple[int, int]:
        """Width and height of the images of a camera, 0 (left) or 1 (right)."""
        return self.right_size_px if camera and self.right_size_px else (self.width_px, self.height_px)


def read_calibration(mav0: Path, names: tuple[str, str] = ("cam0", "cam1")) -> StereoCalibration:
    """Read the ``sensor.yaml`` of the left and the right camera, folders of these names below ``mav0``.

    Raises InputError when a file or key is missing, a value is NaN, T_BS is not a rigid transform, the
    cameras coincide, or their ``bits`` differ.
    """
    left, right = (_read_camera(mav0 / name / "sensor.yaml") for name in names)
    both = " and ".join(names)
    baseline_m = float(np.linalg.norm(right.X_BC0[:3, 3] - left.X_BC0[:3, 3]))
    if baseline_m > MAX_OFFSET_M:
        raise InputError(
            f"{mav0}: {both} are {baseline_m:g} m apart, above {MAX_OFFSET_M:g}; correct their T_BS"
        )
    if baseline_m < MIN_BASELINE_M:
        raise InputError(f"{mav0}: {both} coincide (baseline {baseline_m:g} m); check their T_BS")
    if left.bits != right.bits:
        raise InputError(f"{mav0}: 'bits' of {both} differ, {left.bits} and {right.bits}; correct one")
    size_px = None if left.size_px(0) == right.size_px(0) else right.size_px(0)
    both_cameras = replace(
        left,
        K1=right.K0,
        dist1=right.dist0,
        X_BC1=right.X_BC0,
        fisheye1=right.fisheye0,
        right_size_px=size_px,
    )
    return replace(both_cameras, prior=read_prior(mav0, both_cameras, names))


def read_range_calibration(mav0: Path, name: str = "cam0") -> StereoCalibration:
    """The ``sensor.yaml`` of the only camera, with a virtual right camera like it, for range images.

    Its distance, here 1 m, is to be set by ``with_baseline``. Raises InputError as ``read_calibration``.
    """
    calibration = with_baseline(_read_camera(mav0 / name / "sensor.yaml"), 1.0)
    return replace(calibration, prior=read_prior(mav0, calibration, (name,)))


def with_baseline(calibration: StereoCalibration, baseline_m: float) -> StereoCalibration:
    """The calibration with the right camera beside the left one, parallel to it, along its rows."""
    X_C0C1 = make_pose(np.eye(3), np.array([baseline_m, 0.0, 0.0]))
    return replace(calibration, X_BC1=calibration.X_BC0 @ X_C0C1)


def _read_camera(path: Path) -> StereoCalibration:
    """One ``sensor.yaml``, as both cameras of a rig without a baseline. Raises InputError."""

    def wrong(key: str, what: str) -> InputError:
        return InputError(f"{path} key '{key}': {what}")

    def shown(value: object) -> str:
        text = repr(value)
        return text if len(text) <= 60 else text[:57] + "..."

    sensor = read_mapping(path, "a camera needs its calibration (see docs/dataset.md)")
    if (camera_model := sensor.get("camera_model", "pinhole")) != "pinhole":
        raise wrong("camera_model", f"{shown(camera_model)} is not supported; use pinhole")
    resolution = numbers_at(path, sensor, "resolution", (2,))
    if (resolution < 1).any() or (resolution != np.round(resolution)).any():
        raise wrong("resolution", "expected [width, height] in whole pixels")
    width, height = resolution
    # OpenCV resamples images of up to 32767 px a side.
    if min(width, height) < 16 or max(width, height) > 32_000 or width * height > MAX_PIXELS:
        sides = "sides may have 16 to 32000"
        raise wrong(
            "resolution", f"{width:g}x{height:g} px; {sides}, the image {MAX_PIXELS // 10**6} million"
        )

    fu, fv, cu, cv = numbers_at(path, sensor, "intrinsics", (4,))
    # From fields of view of 175 degrees to 20 seconds of arc.
    low, high = 0.02 * max(width, height), 1e4 * max(width, height)
    if fu <= 0.0 or fv <= 0.0:
        raise wrong("intrinsics", f"focal lengths must be positive, got {fu:g} and {fv:g}")
    if not (low <= fu <= high and low <= fv <= high):
        expected = f"expected {low:g} to {high:g} px for images of {width:g}x{height:g}"
        raise wrong("intrinsics", f"focal lengths {fu:g} and {fv:g}, {expected}")
    if max(fu, fv) > 10.0 * min(fu, fv):
        raise wrong(
            "intrinsics", f"focal lengths {fu:g} and {fv:g} differ by more than a factor of 10; correct one"
        )
    # A part that is read out of a larger sensor may lie beside its principal point.
    if abs(cu - 0.5 * width) > 10.0 * width or abs(cv - 0.5 * height) > 10.0 * height:
        far = "is more than 10 images away from the image; give it in pixels"
        raise wrong("intrinsics", f"the principal point ({cu:g}, {cv:g}) {far}")
    K = np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])

    if "distortion_model" not in sensor:
        raise InputError(
            f"{path} lacks the key 'distortion_model'; give radial-tangential, equidistant (a fisheye), or "
            "none for undistorted images"
        )
    # YAML reads a bare `null` or `~` as None: the same intent as `none`.
    model = str(sensor["distortion_model"]).lower()
    fisheye, dist = model in EQUIDISTANT, np.zeros(4)
    if model != "none":
        if not fisheye and model not in RADIAL_TANGENTIAL:
            valid = ", ".join((*RADIAL_TANGENTIAL, *EQUIDISTANT, "none"))
            raise wrong("distortion_model", f"{shown(model)} is not supported; choose one of {valid}")
        counts = (4,) if fisheye else (4, 5, 8, 12, 14)
        dist = numbers_at(path, sensor, "distortion_coefficients", counts)
        # the highest order of a long lens reaches thousands
        if abs(dist).max() > 1e7:
            raise wrong("distortion_coefficients", f"{abs(dist).max():g} is above {1e7:g}; correct it")

    X = numbers_at(path, sensor, "T_BS", (16,)).reshape(4, 4)
    if abs(X).max() > MAX_OFFSET_M:
        raise wrong("T_BS", f"{abs(X).max():g} is above {MAX_OFFSET_M:g}; give the pose in metres")
    R, last_row_off = X[:3, :3], float(np.abs(X[3] - [0.0, 0.0, 0.0, 1.0]).max())
    # The nearest rigid transform is taken; only rounding in the file is accepted.
    if np.abs(R.T @ R - np.eye(3)).max() > 1e-2 or np.linalg.det(R) < 0.0 or last_row_off > 1e-6:
        raise wrong("T_BS", "not a rigid transform (row-major 4x4 with a rotation); correct it")
    U, _, Vt = np.linalg.svd(R)
    X_BC = make_pose(U @ Vt, X[:3, 3])
    bits = sensor.get("bits")
    if bits is not None and (type(bits) is not int or not 8 <= bits <= 16):
        raise wrong("bits", f"expected the depth of the images, 8 to 16, got {shown(bits)}")
    size_px = (int(width), int(height))
    return StereoCalibration(K, K, dist, dist, X_BC, X_BC, *size_px, bits, fisheye, fisheye)
