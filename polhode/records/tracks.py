"""Measurements with data association: what the front end hands to the back end.

Frames (docs/notation.md): N inertial, R rectified left camera, G geometric frame of the target, P principal
axes at the centre of mass. ``p_N = X_NG @ p_G``; ``p_G = R_GP @ p_P + com_G``.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints
from polhode.records.calibration_effects import CalibrationEffects


@dataclass(frozen=True)
class Wrench:
    """Known force and torque on the target. A row applies until the next, the last one until the end."""

    time_ns: Ints
    """(n,) strictly increasing, on the clock of the frames"""
    force_N: Array
    """(n, 3) along N [N]"""
    torque_P: Array
    """(n, 3) about the centre of mass, along the principal axes [N m]"""


@dataclass(frozen=True)
class StereoTracks:
    """Stereo measurements with data association: all that the back end gets from the images.

    F frames, M observations, L landmarks. Frames without observations are allowed (bridged by the
    dynamics). Stored as ``measurements.npz``.
    """

    rig: RectifiedRig
    timestamps_ns: Ints
    """(F,) strictly increasing."""
    X_NR: Array
    """(F, 4, 4) pose of the rectified left camera in N."""
    frame: Ints
    """(M,) index into the frames."""
    landmark: Ints
    """(M,) index into the landmarks, 0..L-1, each used at least once."""
    uvd_px: Array
    """(M, 3) u left, v, disparity [px]."""
    sigma_px: Array
    """(M, 3) standard deviations of uvd [px]."""
    sigma_camera_p_m: float = 0.0
    """Standard deviation of the inspector's position [m]; 0: exact."""
    sigma_camera_theta_rad: float = 0.0
    """Standard deviation of the inspector's attitude [rad]; 0: exact."""
    X_BR: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) rectified left camera in the inspector's body, whose pose these standard deviations are of."""
    wrench: Wrench | None = None
    """Known force and torque on the target; None: free of known ones."""
    calibration: CalibrationEffects | None = None
    """What errors of the calibration do to the measurements; None: it is exact."""

    def freed(self, correction: CalibrationEffects, left: CalibrationEffects) -> "StereoTracks":
        """The measurements freed of errors (c = 1); ``left``: effects of one sigma of what is left."""
        return replace(self, uvd_px=correction.taken_off(self.rig, self.uvd_px), calibration=left)

    @property
    def n_frames(self) -> int:
        """F"""
        return len(self.timestamps_ns)

    @property
    def n_landmarks(self) -> int:
        """L, those with outliers only among them."""
        return int(self.landmark.max()) + 1 if len(self.landmark) else 0

    @property
    def time_s(self) -> Array:
        """(F,) seconds since the first frame."""
        return np.asarray((self.timestamps_ns - self.timestamps_ns[0]) * 1e-9, dtype=np.float64)


@dataclass(frozen=True)
class RelativePoses:
    """Motion of the target between pairs of frames, by matching and RANSAC (thesis 2.7, 6.3).

    ``p_Ri = X_RiRj @ p_Rj`` for a point fixed to the target, seen in the cameras of frames i and j.
    """

    i: Ints
    """(E,) index of the one frame"""
    j: Ints
    """(E,) index of the other, i < j"""
    X_RiRj: Array
    """(E, 4, 4) from the left camera of j to that of i, for points of the target; translation [m]"""
    inliers: Ints
    """(E,) number of matches that agree with it"""

    def __len__(self) -> int:
        """Number of pairs of frames, E."""
        return len(self.i)
