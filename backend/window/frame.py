"""Measurements of a frame as they enter the window, a frame while the window keeps it, and its landmarks.

Landmarks have a bounded set of slots, which are released when no frame sees them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from polhode.backend.dynamics.so3_exp import rotation_matrices
from polhode.backend.problem.iterate import POSE, POSITION, ROTATION
from polhode.geometry.lie import Array, Bools, Ints, hat, inverse_pose, log_so3, make_pose
from polhode.records.tracks import StereoTracks

FIRST_SLOTS = 1024


@dataclass(frozen=True)
class FrameMeasurements:
    """One stereo pair with its data association."""

    timestamp_ns: int
    X_NR: Array
    """(4, 4) pose of the rectified left camera in N"""
    landmark: Ints
    """(m,) identifiers of the landmarks that are seen, each once"""
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


@dataclass(frozen=True)
class CameraNoise:
    """Standard deviations of the inspector's stated poses; both 0: they are exact."""

    sigma_p_m: float = 0.0
    sigma_theta_rad: float = 0.0
    X_BR: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose of the rectified left camera in the inspector's body"""

    @property
    def exact(self) -> bool:
        return max(self.sigma_p_m, self.sigma_theta_rad) == 0.0

    def information(self, X_NR: Array, R_NG: Array, p_NG: Array) -> Array | None:
        """Information (6, 6) of the target's seen pose about the true one; None when exact.

        The inspector is off by a shift and a turn alpha about itself: p moves by alpha x (p - inspector),
        theta by R_NG^T alpha.
        """
        if self.exact:
            return None
        # where only one of the two is noisy, the other one gets a sigma of 1e-6 m or rad
        shift, turn = max(self.sigma_p_m, 1e-6) ** 2, max(self.sigma_theta_rad, 1e-6) ** 2
        arm = hat(p_NG - (X_NR @ inverse_pose(self.X_BR))[:3, 3])
        covariance = np.zeros((6, 6))
        covariance[POSITION, POSITION] = shift * np.eye(3) - turn * arm @ arm
        covariance[POSITION, ROTATION] = -turn * arm @ R_NG
        covariance[ROTATION, POSITION] = turn * R_NG.T @ arm
        covariance[ROTATION, ROTATION] = turn * np.eye(3)
        return np.asarray(np.linalg.inv(covariance))


def camera_noise_of(tracks: StereoTracks) -> CameraNoise:
    """The camera noise that the sequence states."""
    return CameraNoise(tracks.sigma_camera_p_m, tracks.sigma_camera_theta_rad, tracks.X_BR)


@dataclass
class Frame:
    """A frame in the window: its measurements and its state."""

    number: int
    """number of the frame in the sequence"""
    time_s: float
    X_NR: Array
    """(4, 4) stated pose of the camera"""
    R_ref: Array
    """(3, 3) reference attitude, which theta rotates"""
    x: Array
    """(12,) p_NG, theta, v_N, w_G; changed in place only"""
    slot: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    """(m,) ascending: slots of the landmarks that are observed"""
    uvd_px: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3)"""
    inv_sigma: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) [1/px]"""
    camera_information: Array | None = None
    """(6, 6) information on the seen pose minus the true one; None: the camera's pose is exact"""
    seen: Array = field(init=False)
    """(6,) p_NG, theta as seen from the stated camera pose; without camera noise a view of x"""
    linearized_at: Array | None = None
    """(6,) the seen pose at which the observations are linearized, once the arrival cost depends on it"""

    def __post_init__(self) -> None:
        self.seen = self.x[POSE] if self.camera_information is None else self.x[POSE].copy()
        X_RN = inverse_pose(self.X_NR)
        self.R_RN: Array = np.ascontiguousarray(X_RN[:3, :3])
        self.t_R: Array = np.ascontiguousarray(X_RN[:3, 3])
        """(3,) origin of N in R [m]"""

    @property
    def R_NG(self) -> Array:
        """(3, 3) the true attitude."""
        return np.asarray(self.R_ref @ rotation_matrices(self.x[None, ROTATION])[0])

    @property
    def X_NG_seen(self) -> Array:
        """(4, 4)"""
        return make_pose(self.R_ref @ rotation_matrices(self.seen[None, ROTATION])[0], self.seen[POSITION])

    def recenter(self) -> None:
        """Make the present attitude the reference, unless something else depends on the reference."""
        if self.linearized_at is None and np.any(self.x[ROTATION]):
            R_NG, R_seen = self.R_NG, self.X_NG_seen[:3, :3]
            self.R_ref, self.x[ROTATION] = R_NG, 0.0
            if self.camera_information is not None:
                self.seen[ROTATION] = log_so3(R_NG.T @ R_seen)

    def fix_linearization(self) -> None:
        """From now on linearize the observations at the present pose (first-estimate Jacobians)."""
        if self.linearized_at is None:
            self.linearized_at = self.seen.copy()

    def keep(self, chosen: Bools) -> None:
        """Keep only the ``chosen`` observations (m,)."""
        self.slot, self.uvd_px = self.slot[chosen], self.uvd_px[chosen]
        self.inv_sigma = self.inv_sigma[chosen]


class LandmarkSlots:
    """Slot, position in G and covariance of each landmark."""

    def __init__(self) -> None:
        self._slot_of: dict[int, int] = {}
        self._free: list[int] = list(range(FIRST_SLOTS))[::-1]
        self.name: Ints = np.zeros(FIRST_SLOTS, np.int64)
        self.p_G: Array = np.zeros((FIRST_SLOTS, 3))
        self.covariance: Array = np.zeros((FIRST_SLOTS, 3, 3))
        """[m^2] given the poses"""
        self.views: Ints = np.zeros(FIRST_SLOTS, np.int64)
        """number of observations in the frames of the window"""
        self.refused: Ints = np.zeros(FIRST_SLOTS, np.int64)
        """number of contradicting observations since the last one that agreed"""

    def __len__(self) -> int:
        return len(self.p_G)

    @property
    def used(self) -> Ints:
        """Slots in use."""
        return np.flatnonzero(self.views > 0)

    def find(self, names: Ints) -> Ints:
        """Slot of each landmark (m,); -1 if it is not known."""
        return np.array([self._slot_of.get(int(name), -1) for name in names], dtype=np.int64)

    def take(self, names: Ints) -> Ints:
        """Allocate slots (m,) for new landmarks."""
        while len(self._free) < len(names):
            self._grow()
        slots = np.array([self._free.pop() for _ in names], dtype=np.int64)
        self._slot_of.update(zip(names.tolist(), slots.tolist(), strict=True))
        self.name[slots], self.views[slots], self.refused[slots] = names, 0, 0
        return slots

    def leave(self, slots: Ints) -> None:
        """Remove one observation of each; landmarks without observations are forgotten."""
        self.views[slots] -= 1
        for slot in slots[self.views[slots] == 0].tolist():
            del self._slot_of[int(self.name[slot])]
            self._free.append(slot)

    def _grow(self) -> None:
        n = len(self)
        self._free = list(range(n, 2 * n))[::-1] + self._free
        self.name, self.views, self.refused = (
            np.concatenate([a, np.zeros(n, np.int64)]) for a in (self.name, self.views, self.refused)
        )
        self.p_G = np.concatenate([self.p_G, np.zeros((n, 3))])
        self.covariance = np.concatenate([self.covariance, np.zeros((n, 3, 3))])
