"""A calibrated rig as other programs state it, before it is checked as a run reads it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import ArrayLike

from polhode.geometry.lie import Array, inverse_pose, make_pose
from polhode.records.calibration_prior import CalibrationPrior
from polhode.records.dataset_writer import write_prior, write_sensor
from polhode.records.rig_calibration import MIN_BASELINE_M, read_calibration
from polhode.runtime.errors import InputError

RADIAL_TANGENTIAL, EQUIDISTANT, UNDISTORTED = "radial-tangential", "equidistant", "none"
MODELS = {
    "radial-tangential": RADIAL_TANGENTIAL,
    "radtan": RADIAL_TANGENTIAL,
    "plumb_bob": RADIAL_TANGENTIAL,
    "rational_polynomial": RADIAL_TANGENTIAL,
    "thin_prism": RADIAL_TANGENTIAL,
    "equidistant": EQUIDISTANT,
    "equi": EQUIDISTANT,
    "fisheye": EQUIDISTANT,
    "none": UNDISTORTED,
    "": UNDISTORTED,
}
"""What programs call the models of distortion -> what a dataset calls them."""


@dataclass(frozen=True)
class Camera:
    """A camera on the body B."""

    source: str
    """Where it was read, for messages"""
    intrinsics: tuple[float, float, float, float]
    """fu, fv, cu, cv [px]"""
    model: str
    """radial-tangential, equidistant or none"""
    distortion: tuple[float, ...]
    X_BC: Array
    """(4, 4) pose of the camera in B"""
    size_px: tuple[int, int] | None = None
    """Width and height; None: the file does not state them"""
    bits: int | None = None
    """Depth of 16-bit images; None: not stated"""

    def sized(self, size_px: tuple[int, int]) -> "Camera":
        """The same camera with the size of its images. Raises InputError for another size than it states."""
        if self.size_px not in (None, size_px):
            stated = "x".join(map(str, self.size_px or ()))
            raise InputError(
                f"{self.source}: calibrated for images of {stated} px, but they have "
                f"{size_px[0]}x{size_px[1]}; give the calibration of these images"
            )
        return replace(self, size_px=size_px)

    def cropped(self, left_px: int, top_px: int, width_px: int, height_px: int) -> "Camera":
        """The camera whose images are the part that begins at pixel (left, top)."""
        fu, fv, cu, cv = self.intrinsics
        return replace(self, intrinsics=(fu, fv, cu - left_px, cv - top_px), size_px=(width_px, height_px))


@dataclass(frozen=True)
class Rig:
    """The left and the right camera."""

    left: Camera
    right: Camera
    prior: CalibrationPrior | None = None
    """How well it is known; None: the format does not state it"""
    remarks: tuple[str, ...] = ()
    """What was assumed in reading it, for the user"""

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """Left, right."""
        return self.left, self.right

    @property
    def baseline_m(self) -> float:
        """Distance between the cameras."""
        return float(np.linalg.norm(self.right.X_BC[:3, 3] - self.left.X_BC[:3, 3]))

    def of_depth(self, bits: int) -> "Rig":
        """The rig whose images have ``bits`` bits, where the calibration does not state them."""
        left, right = (replace(camera, bits=camera.bits or bits) for camera in self.cameras)
        return replace(self, left=left, right=right)

    def in_metres(self, unit_m: float) -> "Rig":
        """The rig whose lengths were stated in this unit. Raises InputError: they make no baseline."""
        X_BC = [camera.X_BC.copy() for camera in self.cameras]
        if unit_m != 1.0:
            for X in X_BC:
                X[:3, 3] *= unit_m
        if np.linalg.norm(X_BC[1][:3, 3] - X_BC[0][:3, 3]) < MIN_BASELINE_M:
            raise InputError(
                f"{self.right.source}: the cameras are {unit_m * self.baseline_m:.4g} m apart with --unit "
                f"{'m' if unit_m == 1.0 else 'mm'}; state the unit of the calibration's lengths: --unit m "
                "or mm"
            )
        left, right = (replace(each, X_BC=X) for each, X in zip(self.cameras, X_BC, strict=True))
        # how well it is known was stated in the wrong unit, too
        return replace(self, left=left, right=right, prior=self.prior if unit_m == 1.0 else None)

    def on_body(self, X_BC0: Array) -> "Rig":
        """The rig on another body, in which the left camera has the pose X_BC0 (4, 4)."""
        if np.array_equal(self.left.X_BC, X_BC0):
            return self
        X_01 = self.right.X_BC
        if not np.array_equal(self.left.X_BC, np.eye(4)):
            X_01 = inverse_pose(self.left.X_BC) @ X_01
        left, right = replace(self.left, X_BC=X_BC0 + 0.0), replace(self.right, X_BC=X_BC0 @ X_01 + 0.0)
        # how well the pose in another body is known says nothing of this one
        prior = None if self.prior is None else self.prior.without("cam0.p_", "cam0.theta_")
        return Rig(left, right, prior, self.remarks)


def distortion_of(source: str, name: str, coefficients: Sequence[float]) -> tuple[str, tuple[float, ...]]:
    """Model and coefficients as a dataset states them. Raises InputError for a model that it does not know.

    A fifth coefficient (k3) of 0 is left out: ROS always states five.
    """
    model = MODELS.get(name.strip().lower())
    if model is None:
        known = ", ".join(sorted(filter(None, MODELS)))
        raise InputError(f"{source}: the distortion model {name[:40]!r} is not known; known are {known}")
    values = tuple(float(value) for value in coefficients)
    if model == UNDISTORTED or not values:
        return UNDISTORTED, (0.0, 0.0, 0.0, 0.0)
    if model == RADIAL_TANGENTIAL and len(values) == 5 and values[4] == 0.0:
        values = values[:4]
    return model, values


def camera_of(
    source: str,
    K: ArrayLike,
    distortion_model: str,
    coefficients: ArrayLike,
    X_BC: Array,
    size_px: Sequence[float] | None,
    bits: int | None = None,
) -> Camera:
    """A camera by its matrix (3, 3), or fu, fv, cu, cv (4,), and the name that a program has for its
    distortion.

    Raises InputError for a model that is not known.
    """
    values = np.asarray(K, dtype=np.float64)
    fu, fv, cu, cv = (values if values.ndim == 1 else values[[0, 1, 0, 1], [0, 1, 2, 2]]).tolist()
    model, distortion = distortion_of(source, distortion_model, np.ravel(coefficients).tolist())
    size = None if size_px is None else (int(size_px[0]), int(size_px[1]))
    return Camera(source, (fu, fv, cu, cv), model, distortion, X_BC, size, bits)


def pose_from_inverse(X_CB: ArrayLike) -> Array:
    """(4, 4) pose of a camera in B from that of B in the camera; zeros have no sign."""
    return np.asarray(inverse_pose(np.asarray(X_CB, dtype=np.float64))) + 0.0


def with_virtual_camera(camera: Camera) -> Rig:
    """The rig of a single camera, whose ranges take the place of a second one 1 m beside it."""
    return Rig(camera, replace(camera, X_BC=camera.X_BC @ make_pose(np.eye(3), np.array([1.0, 0.0, 0.0]))))


def write_rig(mav0: Path, rig: Rig, rate_hz: float, cameras: int = 2) -> None:
    """Write ``sensor.yaml`` of both cameras, or of the first one; their sizes are known."""
    for index, camera in enumerate(rig.cameras[:cameras]):
        assert camera.size_px is not None
        fu, fv, cu, cv = camera.intrinsics
        K = np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])
        write_sensor(
            mav0 / f"cam{index}",
            K,
            np.array(camera.distortion),
            camera.X_BC,
            camera.size_px,
            rate_hz=rate_hz,
            bits=camera.bits or 8,
            fisheye=camera.model == EQUIDISTANT,
        )
    if rig.prior is not None:
        write_prior(mav0, rig.prior)


def require_usable(rig: Rig) -> None:
    """Raise InputError, which names the file of the calibration, unless a run can read the rig."""
    with TemporaryDirectory() as folder:
        mav0 = Path(folder) / "mav0"
        write_rig(mav0, rig, 1.0)
        try:
            read_calibration(mav0)
        except InputError as error:
            text = str(error)
            for index, camera in enumerate(rig.cameras):
                text = text.replace(str(mav0 / f"cam{index}" / "sensor.yaml"), camera.source)
            raise InputError(text.replace(str(mav0), rig.left.source)) from None
