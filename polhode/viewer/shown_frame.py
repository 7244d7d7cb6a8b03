"""What is shown of a frame, whether it comes from a finished run, a sequence or a stream."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from polhode.frontend.rectification import Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, make_pose
from polhode.records.rig_calibration import StereoCalibration

PLANE_OVER_BASELINE = 5.0


@dataclass(frozen=True)
class ShownRig:
    """Two cameras as pinholes: those of a rectified pair, or those of a rig without their distortion."""

    K: tuple[Array, Array]
    """(3, 3) each [px], integer coordinates at pixel centres"""
    sizes_px: tuple[tuple[int, int], tuple[int, int]]
    """Width and height of each image"""
    X_LR: Array
    """(4, 4) pose of the right camera in the left one"""

    @property
    def plane_m(self) -> float:
        """Distance at which an image is drawn before its camera, until that of the target is known [m]."""
        return PLANE_OVER_BASELINE * float(np.linalg.norm(self.X_LR[:3, 3]))

    @classmethod
    def rectified(cls, rig: RectifiedRig) -> Self:
        """The cameras of a rectified pair."""
        K_right = rig.K
        K_right[0, 2] -= rig.disparity_offset_px
        size = rig.width_px, rig.height_px
        return cls((rig.K, K_right), (size, size), make_pose(np.eye(3), [rig.baseline_m, 0.0, 0.0]))

    @classmethod
    def recorded(cls, calibration: StereoCalibration) -> Self:
        """The cameras as calibrated."""
        return cls(
            (calibration.K0, calibration.K1),
            (calibration.size_px(0), calibration.size_px(1)),
            inverse_pose(calibration.X_BC0) @ calibration.X_BC1,
        )


def known_ratios(k: Array, cov_k: Array, determined: Bools) -> tuple[Array, Array]:
    """Ratios k (..., 2) and their sigmas for ``ShownFrame.ratios``; determined (..., 2)."""
    sigma = np.sqrt(np.abs(np.diagonal(cov_k, axis1=-2, axis2=-1)))
    return np.where(determined, k, np.nan), np.where(determined, sigma, np.inf)


@dataclass(frozen=True)
class ShownFeatures:
    """The observations of a frame in its left image, n of them."""

    uv_px: Array
    """(n, 2)"""
    landmark: Ints
    """(n,) by which they are joined to tracks"""
    inlier: Bools
    """(n,) whether they agree with the motion"""


@dataclass(frozen=True)
class ShownMotion:
    """The state of the target; undetermined quantities have a variance of inf."""

    r_N: Array
    """(3,) [m]"""
    v_N: Array
    """(3,) [m/s]"""
    R_NP: Array
    """(3, 3)"""
    w_P: Array
    """(3,) [rad/s]"""
    covariance: Array
    """(12, 12) in the order r (N), v (N), theta (P), w (P)"""
    X_NG: Array
    """(4, 4)"""
    moments: Array
    """(3,) Jxx >= Jyy >= Jzz, the middle one 1"""


@dataclass(frozen=True)
class ShownFrame:
    """One frame; None or empty where it has no such thing."""

    number: int
    time_s: float
    """Since the first frame"""
    X_NL: Array
    """(4, 4) pose of the left camera whose image is shown"""
    left: Image | None = None
    right: Image | None = None
    mask_left: Bools | None = None
    mask_right: Bools | None = None
    features: ShownFeatures | None = None
    motion: ShownMotion | None = None
    ratios: tuple[Array, Array] | None = None
    """k1 and k2 as known at the frame, NaN until the motion determines them, and their sigmas, (2,) each"""
    residual_rms_px: Array | None = None
    """(3,) of u, v, disparity; NaN where the frame has no inliers"""
    landmarks_G: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(L, 3) [m] of a finished run those that this frame is the first to observe, of a stream all of them"""
