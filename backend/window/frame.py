"""Frames and landmarks as the window keeps them; the observations, condensed to information on the poses.

Landmarks have a bounded set of slots, which are released when no frame sees them. They are eliminated from
the observations.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from polhode.backend.dynamics.so3_exp import right_jacobians, rotation_matrices
from polhode.backend.problem.iterate import N_POSE, POSE, POSITION, ROTATION
from polhode.backend.solvers.robust_kernel import robust_weight
from polhode.backend.solvers.schur import (
    back_substitute,
    mirror,
    stereo_normal_equations,
    stereo_residuals,
    subtract_landmarks,
)
from polhode.geometry.lie import Array, Bools, Ints, hat, inverse_pose, log_so3, make_pose
from polhode.records.tracks import StereoTracks
from polhode.runtime.compiled import compiled

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
    doubts: Array = field(default_factory=lambda: np.zeros(3))
    """Since the frame before, standard deviations of the time [s], of a change of velocity [m/s], of rate
    [rad/s]"""
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


STEREO_GATE = 4.5
"""Largest norm of a whitened residual that agrees with the others; of Gaussian ones 1 in 5700 is larger."""


@dataclass(frozen=True)
class WindowObservations:
    """Observations of F frames sorted by landmark, without landmarks that are seen only once."""

    frame: Ints
    """(M,)"""
    landmark: Ints
    """(M,) ascending"""
    start: Ints
    """(L + 1,) the observations of landmark l are start[l]:start[l + 1]"""
    uvd_px: Array
    inv_sigma: Array
    slot: Ints
    """(L,) slots of the landmarks"""

    def select(self, landmarks: Bools, without_frame: int = -1) -> "WindowObservations":
        """Observations of the chosen landmarks (L,), without those in one frame."""
        use = landmarks[self.landmark] & (self.frame != without_frame)
        number = np.cumsum(landmarks) - 1
        landmark = number[self.landmark[use]]
        start = np.searchsorted(landmark, np.arange(int(landmarks.sum()) + 1))
        return WindowObservations(
            self.frame[use], landmark, start, self.uvd_px[use], self.inv_sigma[use], self.slot[landmarks]
        )

    def common_with(self, frame: int) -> "WindowObservations":
        """Observations of the landmarks that one frame sees."""
        seen = np.zeros(len(self.slot), bool)
        seen[self.landmark[self.frame == frame]] = True
        return self.select(seen)


def gather_observations(frames: list[Frame], n_slots: int) -> WindowObservations:
    """Gather the observations of the frames."""
    count = np.array([len(frame.slot) for frame in frames])
    slot = np.concatenate([frame.slot for frame in frames])
    seen = np.bincount(slot, minlength=n_slots)
    number = np.cumsum(seen >= 2) - 1
    use = np.flatnonzero(seen[slot] >= 2)
    # NumPy uses radix sort for integers of 16 bits
    order = use[np.argsort(slot[use].astype(np.uint16 if n_slots < 2**16 else np.int64), kind="stable")]
    landmark = number[slot[order]]
    kept = np.flatnonzero(seen >= 2)
    return WindowObservations(
        frame=np.repeat(np.arange(len(frames)), count)[order],
        landmark=landmark,
        start=np.concatenate([[0], np.cumsum(seen[kept])]),
        uvd_px=np.concatenate([frame.uvd_px for frame in frames])[order],
        inv_sigma=np.concatenate([frame.inv_sigma for frame in frames])[order],
        slot=kept,
    )


class FramePoses:
    """Poses of F frames, at which the observations are evaluated and at which they are linearized."""

    def __init__(self, frames: list[Frame]) -> None:
        self.R_RN, self.t_R = np.stack([f.R_RN for f in frames]), np.stack([f.t_R for f in frames])
        now = np.stack([f.seen for f in frames])
        linearized = np.stack([f.seen if f.linearized_at is None else f.linearized_at for f in frames])
        to_camera = self.R_RN @ np.stack([f.R_ref for f in frames])
        self.p_NG: Array = np.ascontiguousarray(now[:, POSITION])
        self.A: Array = to_camera @ rotation_matrices(now[:, ROTATION])
        """(F, 3, 3) R_RN R_NG"""
        self.p_linearized: Array = np.ascontiguousarray(linearized[:, POSITION])
        self.A_linearized: Array = to_camera @ rotation_matrices(linearized[:, ROTATION])
        self.Jr = right_jacobians(linearized[:, ROTATION])
        """(F, 3, 3) right Jacobian at the theta of the linearization"""


@dataclass(frozen=True)
class ObservationModel:
    """How observations are weighted: the camera, the Cauchy kernel's scale, and the gain of its weights."""

    rig: Array
    """(5,) as ``MotionData.rig``"""
    robust_scale: float
    gain: float = 1.0
    """``robust_gain``; 1: the weights of the kernel alone"""


@dataclass(frozen=True)
class CondensedVision:
    """Information on the poses, and the blocks from which the steps of the landmarks follow."""

    S: Array
    """(6 F, 6 F)"""
    g: Array
    """(6 F,)"""
    observations: WindowObservations
    E: Array
    """(M, 6, 3)"""
    C_inv: Array
    """(L, 3, 3)"""
    h: Array
    """(L, 3)"""
    squared: Array
    """(M,) squared norms of the whitened residuals"""

    def landmark_steps(self, step: Array) -> Array:
        """(L, 3) that follow from the step (6 F,) of the poses."""
        s = self.observations
        return back_substitute(step, s.frame, s.start, self.E, self.C_inv, -self.h, N_POSE)


def residuals(observations: WindowObservations, poses: FramePoses, rig: Array, p_G: Array) -> Array:
    """Whitened (M, 3) at the present poses; p_G (L, 3)."""
    return stereo_residuals(
        observations.frame, observations.landmark, observations.uvd_px, observations.inv_sigma, rig,
        poses.A, poses.R_RN, poses.t_R, poses.p_NG, p_G,
    )  # fmt: skip


def condense(
    observations: WindowObservations, poses: FramePoses, model: ObservationModel, p_G: Array
) -> CondensedVision:
    """Linearize the observations; eliminate their landmarks p_G (L, 3)."""
    r = residuals(observations, poses, model.rig, p_G)
    s = np.sum(r**2, axis=1)
    H6, g6, C, h, E = stereo_normal_equations(
        observations.frame, observations.landmark, observations.inv_sigma, model.rig,
        poses.A_linearized, poses.R_RN, poses.t_R, poses.p_linearized, p_G, poses.Jr,
        r, model.gain * robust_weight(s, model.robust_scale), np.zeros_like(s),
    )  # fmt: skip
    n = len(H6)
    blocks, g = np.zeros((n, N_POSE, n, N_POSE)), g6.ravel().copy()
    blocks[np.arange(n), :, np.arange(n), :] = H6
    S = blocks.reshape(N_POSE * n, N_POSE * n)
    C_inv = inverted(C)
    subtract_landmarks(S, g, observations.frame, observations.start, E, C_inv, h, N_POSE)
    mirror(S)
    return CondensedVision(S, g, observations, E, C_inv, h, s)


@compiled
def inverted(C: Array) -> Array:
    """Inverses of symmetric positive-definite blocks (L, 3, 3)."""
    out = np.empty_like(C)
    for n in range(len(C)):
        a, b, c = C[n, 0, 0], C[n, 1, 0], C[n, 2, 0]
        d, e, f = C[n, 1, 1], C[n, 2, 1], C[n, 2, 2]
        A, B, D = d * f - e * e, c * e - b * f, b * e - c * d
        scale = 1.0 / (a * A + b * B + c * D)
        out[n, 0, 0], out[n, 1, 1], out[n, 2, 2] = A * scale, (a * f - c * c) * scale, (a * d - b * b) * scale
        out[n, 0, 1] = out[n, 1, 0] = B * scale
        out[n, 0, 2] = out[n, 2, 0] = D * scale
        out[n, 1, 2] = out[n, 2, 1] = (b * c - a * e) * scale
    return out


def information_of(
    leaving: int, observations: WindowObservations, poses: FramePoses, model: ObservationModel, p_G: Array
) -> tuple[Array, Array]:
    """Information on the poses from the observations of frame ``leaving``, given all others: H and gradient.

    ``observations`` holds all observations of the landmarks that it sees.

    With this in the arrival cost in place of the observations no information is lost at that moment, and none
    is counted twice later: the likelihood is p(leaving | rest) p(rest), and only the second factor changes
    later.
    """
    every = np.ones(len(observations.slot), bool)
    whole, rest = (
        condense(part, poses, model, p_G)
        for part in (observations, observations.select(every, without_frame=leaving))
    )
    return whole.S - rest.S, whole.g - rest.g
