"""The unknowns of the window: key poses, recent states, constants, and the arrival cost about all of them."""

from dataclasses import dataclass, field

import numpy as np

from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.inertia import InertiaForm
from polhode.backend.problem.iterate import N_CONSTANTS, N_POSE, N_STATE, POSE
from polhode.backend.window.frame import Frame
from polhode.backend.window.problem import Quadratic, add_block, eliminate, others, step_jacobians
from polhode.geometry.lie import Array, Ints

Part = tuple[Ints, Array, Array]
"""Entries of a vector, information about them, its gradient."""


@dataclass
class ActiveWindow:
    """The unknowns as one vector: seen poses, recent states, com_G, xi.

    A seen pose is that of the target as seen from the stated camera pose. Each key pose has six unknowns
    (p_NG, theta), and so has each recent seen pose if the camera's pose is noisy; each recent state has 12.
    """

    noisy_camera: bool = False
    keys: list[Frame] = field(default_factory=list)
    recent: list[Frame] = field(default_factory=list)
    steps: Steps = field(default_factory=Steps.none)
    """between the recent states; the history has its own"""
    constants: Array = field(default_factory=lambda: np.zeros(N_CONSTANTS))
    """(8,) com_G, xi"""
    arrival: Quadratic = field(default_factory=lambda: Quadratic(np.zeros((0, 0)), np.zeros(0), np.zeros(0)))
    """information from all that was marginalized, without the weak prior; empty while the history is kept"""

    @property
    def frames(self) -> list[Frame]:
        """Key frames, then recent frames: in the order of time."""
        return [*self.keys, *self.recent]

    @property
    def seen_frames(self) -> list[Frame]:
        """Frames whose seen pose is not part of a state."""
        return self.frames if self.noisy_camera else self.keys

    @property
    def n_seen(self) -> int:
        """Number of entries before the states."""
        return N_POSE * len(self.seen_frames)

    @property
    def seen_entries(self) -> Ints:
        """(6 F,) entries of the seen poses of all frames."""
        if self.noisy_camera:
            return np.arange(self.n_seen)
        return np.concatenate([np.arange(self.n_seen), self.pose_entries])

    @property
    def pose_entries(self) -> Ints:
        """(6 W,) entries of the true poses of the recent states."""
        start = self.n_seen + N_STATE * np.arange(len(self.recent))
        return np.asarray(start[:, None] + np.arange(N_POSE)).ravel()

    @property
    def R_ref(self) -> Array:
        """(W, 3, 3) reference attitudes of the recent states."""
        return np.stack([frame.R_ref for frame in self.recent])

    def vector(self) -> Array:
        """The unknowns (n,)."""
        return np.concatenate([*self._numbers(), self.constants])

    def _numbers(self) -> list[Array]:
        """Seen poses (6,) and states (12,), which are changed in place."""
        return [*(frame.seen for frame in self.seen_frames), *(frame.x for frame in self.recent)]

    def set_vector(self, x: Array) -> None:
        """Set the unknowns."""
        start = 0
        for values in self._numbers():
            values[:] = x[start : start + len(values)]
            start += len(values)
        self.constants = x[-N_CONSTANTS:].copy()

    def extend_arrival(self) -> None:
        """Extend the arrival cost by a new frame, about which it has no information."""
        x, last = self.vector(), len(self.recent) - 1
        new = np.arange(N_STATE) + self.n_seen + N_STATE * last
        if self.noisy_camera:
            new = np.concatenate([np.arange(self.n_seen - N_POSE, self.n_seen), new])
        old = others(new, len(x))
        H, g, x0 = np.zeros((len(x), len(x))), np.zeros(len(x)), x.copy()
        add_block(H, old, self.arrival.H)
        g[old], x0[old] = self.arrival.g, self.arrival.x0
        self.arrival = Quadratic(H, g, x0)

    def absorb(self, parts: list[Part], gone: Ints) -> None:
        """Add information, with gradients at the present vector, to the arrival cost; eliminate entries.

        The caller removes the eliminated unknowns from the frames.
        """
        x = self.vector()
        H, g = self.arrival.H.copy(), self.arrival.gradient(x)
        add_parts(H, g, parts)
        kept = others(gone, len(g))
        left = eliminate(H, g, gone, kept)
        self.arrival = Quadratic(left.H, left.g, x[kept])

    def oldest_step(self, form: InertiaForm, R_inertia: Array) -> Part:
        """The dynamics from the oldest recent state to the next."""
        x, start = self.vector(), self.n_seen
        both = np.r_[start : start + 2 * N_STATE, len(x) - N_CONSTANTS : len(x)]
        first = self.steps.part(slice(0, 1))
        r, D = step_jacobians(x[both], self.R_ref[:2], first, form, R_inertia)
        return both, D[0].T @ D[0], D[0].T @ r[0]

    def camera_parts(self, n_frames: int | None = None) -> list[Part]:
        """Information on the difference of seen and true poses of the (first) recent frames."""
        if not self.noisy_camera:
            return []
        seen = self.seen_entries[N_POSE * len(self.keys) :].reshape(-1, N_POSE)
        true = self.pose_entries.reshape(-1, N_POSE)
        frames = self.recent[:n_frames]
        return [camera_part(frame, a, b) for frame, a, b in zip(frames, seen, true, strict=False)]

    def oldest_velocities(self) -> Ints:
        """Entries of the oldest recent frame that are eliminated when its seen pose becomes a key."""
        first = 0 if self.noisy_camera else N_POSE
        return np.arange(self.n_seen + first, self.n_seen + N_STATE)

    def oldest_becomes_key(self) -> None:
        """The oldest recent frame becomes a key frame."""
        self.keys.append(self.recent.pop(0))


def camera_part(frame: Frame, seen: Ints, true: Ints) -> Part:
    """Information on the seen pose minus the true one, by the camera's noise; entries (6,) of both."""
    assert frame.camera_information is not None
    one = np.array([[1.0, -1.0], [-1.0, 1.0]])
    force = frame.camera_information @ (frame.seen - frame.x[POSE])
    entries = np.concatenate([seen, true])
    return entries, np.kron(one, frame.camera_information), np.concatenate([force, -force])


def add_parts(H: Array, g: Array, parts: list[Part]) -> None:
    """Add each part to H and g in place."""
    for entries, more, gradient in parts:
        add_block(H, entries, more)
        g[entries] += gradient
