"""The observations of the window, condensed to information on its poses by elimination of the landmarks."""

from dataclasses import dataclass

import numpy as np

from polhode.backend.dynamics.so3_exp import right_jacobians, rotation_matrices
from polhode.backend.problem.iterate import N_POSE, POSITION, ROTATION
from polhode.backend.solvers.robust_kernel import robust_weight
from polhode.backend.solvers.schur import (
    back_substitute,
    mirror,
    stereo_normal_equations,
    stereo_residuals,
    subtract_landmarks,
)
from polhode.backend.window.frame import Frame
from polhode.geometry.lie import Array, Bools, Ints
from polhode.runtime.compiled import compiled

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
