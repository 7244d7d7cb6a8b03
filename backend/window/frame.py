"""What goes into the window, frame by frame, and a frame while the window holds it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from backend.kernels import N_STATE
from polhode.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.records import Bools, Ints, StereoTracks


@dataclass(frozen=True)
class FrameMeasurements:
    """One stereo pair with its data association."""

    timestamp_ns: int
    X_NR: Array
    """(4, 4) pose of the rectified left camera in N"""
    landmark: Ints
    """(m,) which landmarks are seen, any numbers, each once"""
    uvd_px: Array
    """(m, 3)"""
    sigma_px: Array
    """(m, 3)"""


def frames_of(tracks: StereoTracks) -> Iterator[FrameMeasurements]:
    """The sequence in the order of time."""
    order = np.lexsort((tracks.landmark, tracks.frame))
    start = np.searchsorted(tracks.frame[order], np.arange(tracks.n_frames + 1))
    for k in range(tracks.n_frames):
        use = order[start[k] : start[k + 1]]
        yield FrameMeasurements(
            int(tracks.timestamps_ns[k]),
            tracks.X_NR[k],
            tracks.landmark[use],
            tracks.uvd_px[use],
            tracks.sigma_px[use],
        )


@dataclass
class Frame:
    """A frame that the window holds: what is measured in it, and its state."""

    number: int
    """counts the frames that came"""
    time_s: float
    R_RN: Array
    """(3, 3)"""
    t_R: Array
    """(3,) origin of N in R [m]"""
    slot: Ints
    """(m,) ascending: where the window keeps the landmark"""
    uvd_px: Array
    """(m, 3)"""
    inv_sigma: Array
    """(m, 3) [1/px]"""
    R_ref: Array
    """(3, 3) theta turns it"""
    x: Array
    """(12,) p_NG, theta, v_N, w_G"""
    held: Array | None = None
    """(6,) p_NG, theta at which vision is linearised, once the arrival cost depends on this pose"""

    @property
    def R_NG(self) -> Array:
        """(3, 3)"""
        return np.asarray(self.R_ref @ exp_so3(self.x[3:6]))

    @property
    def X_NG(self) -> Array:
        """(4, 4)"""
        return make_pose(self.R_NG, self.x[:3])

    def settle(self) -> None:
        """Make the present attitude the reference, as long as nothing else depends on the reference."""
        if self.held is None and np.any(self.x[3:6]):
            self.R_ref, self.x[3:6] = self.R_NG, 0.0

    def hold(self) -> None:
        """From now on vision is linearised at the present pose (first-estimate Jacobians)."""
        if self.held is None:
            self.held = self.x[:6].copy()

    def keep(self, chosen: Bools) -> None:
        """Leave out the observations that are not ``chosen`` (m,)."""
        self.slot, self.uvd_px, self.inv_sigma = (
            self.slot[chosen],
            self.uvd_px[chosen],
            self.inv_sigma[chosen],
        )


def camera_of(X_NR: Array) -> tuple[Array, Array]:
    """R_RN (3, 3) and t_R (3,)."""
    X_RN = inverse_pose(X_NR)
    return np.ascontiguousarray(X_RN[:3, :3]), np.ascontiguousarray(X_RN[:3, 3])


def states_of(frames: list[Frame]) -> Array:
    """(F, 12)"""
    return np.stack([frame.x for frame in frames]) if frames else np.zeros((0, N_STATE))
