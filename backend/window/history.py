"""The unknowns of the window with the arrival cost about them, and the first frames of a run as a whole.

An arrival cost is expanded about the inertia at its time; if the inertia changes later the arrival cost is
wrong and overconfident. Therefore the states of the first frames are kept until the inertia is known. Only
the observations of frames that are not key frames are marginalized, as information on the poses, which does
not depend on the inertia. If there are too many frames, the one with the closest neighbours is removed, and
one longer step of the dynamics replaces two.
"""

from dataclasses import dataclass, field

import numpy as np

from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.inertia import InertiaForm
from polhode.backend.problem.iterate import N_CONSTANTS, N_POSE, N_STATE, POSE, RATE, VELOCITY
from polhode.backend.window.frame import CondensedVision, Frame
from polhode.backend.window.problem import (
    DisturbanceLevels,
    Elimination,
    Quadratic,
    add_block,
    eliminate,
    others,
    step_jacobians,
    whitened_steps,
)
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


@dataclass(frozen=True)
class HistoryVision:
    """Information from all observations on the true states, and how the seen poses follow them."""

    quadratic: Quadratic
    """information on the states of N frames and the constants (12 N + 8,)"""
    poses: Ints
    """(6 N,) entries of their poses"""
    elimination: Elimination | None
    """elimination of the seen poses; None: they are the true ones"""

    def seen_steps(self, step: Array) -> Array:
        """Steps (6 N,) of the seen poses, from the step (12 N + 8,) of the unknowns."""
        at_poses = step[self.poses]
        return at_poses if self.elimination is None else self.elimination.follow(at_poses)


class History:
    """States of all frames so far, and information on their poses from marginalized observations."""

    def __init__(self, first: Frame, gauge_information: Array) -> None:
        """gauge_information (6,): the prior that fixes G at the true pose of the first frame."""
        self.frames: list[Frame] = [first]
        self.n_added = 1
        """number of frames so far, including removed ones"""
        self._gauge, self._first = gauge_information, first.x[POSE].copy()
        self._H, self._b = np.zeros((N_POSE, N_POSE)), np.zeros(N_POSE)
        self.steps = Steps.none()
        """between all frames, at the last solution"""

    @property
    def noisy_camera(self) -> bool:
        return self.frames[0].camera_information is not None

    def append(self, frame: Frame) -> None:
        """Add a new frame; its state is shared with the window."""
        n = len(self._b)
        H = np.zeros((n + N_POSE, n + N_POSE))
        H[:n, :n] = self._H
        self._H, self._b = H, np.concatenate([self._b, np.zeros(N_POSE)])
        self.frames.append(frame)
        self.n_added += 1

    def thin(self, active: ActiveWindow, most: int) -> None:
        """Remove states until ``most`` are left; never the first one, nor active ones."""
        stay = {self.frames[0].number, *(frame.number for frame in active.frames)}
        while len(self.frames) > most:
            time_s = np.array([frame.time_s for frame in self.frames])
            gap_s = np.append(time_s[2:] - time_s[:-2], np.inf)
            free = np.array([frame.number not in stay for frame in self.frames[1:]])
            if not free.any():
                return
            self._remove_frame(1 + int(np.argmin(np.where(free, gap_s, np.inf))))

    def _remove_frame(self, n: int) -> None:
        """Remove frame n; its pose is eliminated from the information on the other poses."""
        gone = np.arange(N_POSE * n, N_POSE * (n + 1))
        kept = others(gone, len(self._b))
        own, across = self._H[np.ix_(gone, gone)], self._H[np.ix_(gone, kept)]
        values, vectors = np.linalg.eigh(own)
        # few landmarks leave directions of the pose undetermined
        known = values > 1e-9 * values[-1]
        root = vectors[:, known] / np.sqrt(values[known]) if values[-1] > 0.0 else np.zeros((N_POSE, 0))
        through = root.T @ across
        self._H = self._H[np.ix_(kept, kept)] - through.T @ through
        self._b = self._b[kept] - through.T @ (root.T @ self._b[gone])
        # one longer step has the doubts of both
        self.frames[n + 1].doubts = np.hypot(self.frames[n].doubts, self.frames[n + 1].doubts)
        del self.frames[n]

    def absorb(self, frames: list[Frame], H: Array, g: Array) -> None:
        """Add marginalized observations: H, g at the present seen poses of ``frames`` (6 each)."""
        at = self.entries(frames, N_POSE)
        add_block(self._H, at, H)
        self._b[at] += g - H @ np.concatenate([frame.seen for frame in frames])

    def entries(self, frames: list[Frame], stride: int = N_STATE) -> Ints:
        """(6 F,) entries of the poses of ``frames`` among those of all frames, each ``stride`` long."""
        index = {frame.number: n for n, frame in enumerate(self.frames)}
        start = np.array([stride * index[frame.number] for frame in frames], dtype=np.int64)
        return np.asarray(start[:, None] + np.arange(N_POSE)).ravel()

    @property
    def R_ref(self) -> Array:
        """(N, 3, 3)"""
        return np.stack([frame.R_ref for frame in self.frames])

    def vector(self, constants: Array) -> Array:
        """States of all frames and the constants (12 N + 8,)."""
        return np.concatenate([*(frame.x for frame in self.frames), constants])

    def set_states(self, x: Array, vision: HistoryVision) -> Array:
        """Set the states from a vector, not the constants. Returns the steps of the seen poses (6 N,)."""
        step = vision.seen_steps(x - vision.quadratic.x0)
        for n, frame in enumerate(self.frames):
            frame.x[:] = x[N_STATE * n : N_STATE * (n + 1)]
            if self.noisy_camera:
                frame.seen += step[N_POSE * n : N_POSE * (n + 1)]
        return step

    def _past_vision(self) -> tuple[Array, Array]:
        """Information (6 N, 6 N) on the seen poses from marginalized observations, and its gradient."""
        return self._H.copy(), self._H @ np.concatenate([frame.seen for frame in self.frames]) + self._b

    def vision(self, active: ActiveWindow, condensed: CondensedVision) -> HistoryVision:
        """Information from all observations, marginalized and active, about the present states."""
        x, n = self.vector(active.constants), N_POSE * len(self.frames)
        H, g = np.zeros((len(x), len(x))), np.zeros(len(x))
        poses = self.entries(self.frames)
        of_seen, slope = self._past_vision()
        at = self.entries(active.frames, N_POSE)
        add_block(of_seen, at, condensed.S)
        slope[at] += condensed.g
        elimination = None
        if self.noisy_camera:
            both, along = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
            both[:n, :n], along[:n] = of_seen, slope
            self._add_cameras(both, along, np.arange(n), np.arange(n, 2 * n), len(self.frames))
            elimination = eliminate(both, along, np.arange(n), np.arange(n, 2 * n))
            of_seen, slope = elimination.H, elimination.g
        H[np.ix_(poses, poses)], g[poses] = of_seen, slope
        self._add_gauge(H, g, poses)
        return HistoryVision(Quadratic(H, g, x), poses, elimination)

    def _add_gauge(self, H: Array, g: Array, true: Ints) -> None:
        first = true[:N_POSE]
        H[first, first] += self._gauge
        g[first] += self._gauge * (self.frames[0].x[POSE] - self._first)

    def _add_cameras(self, H: Array, g: Array, seen: Ints, true: Ints, n_frames: int) -> None:
        pairs = zip(self.frames[:n_frames], seen.reshape(-1, N_POSE), true.reshape(-1, N_POSE), strict=False)
        add_parts(H, g, [camera_part(frame, a, b) for frame, a, b in pairs])

    def steps_at(self, x: Array, J_G: Array, J_noise: Array, disturbances: DisturbanceLevels) -> Steps:
        """The steps between all frames, whitened at the rates in x (``whitened_steps``)."""
        w_G = x[:-N_CONSTANTS].reshape(-1, N_STATE)[:-1, RATE]
        dt_s = np.diff([frame.time_s for frame in self.frames])
        speed = np.linalg.norm(x[:-N_CONSTANTS].reshape(-1, N_STATE)[:-1, VELOCITY], axis=1)
        doubts = np.column_stack([[frame.doubts for frame in self.frames[1:]], speed])
        return whitened_steps(w_G, J_G, J_noise, dt_s, disturbances, doubts)

    def expand_arrival(self, active: ActiveWindow, form: InertiaForm, R_inertia: Array) -> None:
        """Give the window its steps, and its arrival cost: all but its own observations and dynamics."""
        x, n = self.vector(active.constants), N_POSE * len(self.frames)
        n_seen = n if self.noisy_camera else 0
        size, n_old = n_seen + len(x), len(self.frames) - len(active.recent)
        H, g = np.zeros((size, size)), np.zeros(size)
        true = n_seen + self.entries(self.frames)
        seen = np.arange(n) if self.noisy_camera else true
        of_seen, slope = self._past_vision()
        H[np.ix_(seen, seen)], g[seen] = of_seen, slope
        self._add_gauge(H, g, true)
        if self.noisy_camera:
            self._add_cameras(H, g, seen, true, n_old)
        if n_old > 0:
            r, D = step_jacobians(x, self.R_ref, self.steps, form, R_inertia)
            square, slope = np.swapaxes(D, 1, 2) @ D, (np.swapaxes(D, 1, 2) @ r[:, :, None])[:, :, 0]
            for k in range(n_old):
                start = n_seen + N_STATE * k
                at = np.r_[start : start + 2 * N_STATE, size - N_CONSTANTS : size]
                add_parts(H, g, [(at, square[k], slope[k])])
        of_frames = self.entries(active.seen_frames, N_POSE if self.noisy_camera else N_STATE)
        kept = np.concatenate([of_frames, np.arange(n_seen + N_STATE * n_old, size)])
        left = eliminate(H, g, others(kept, size), kept)
        active.arrival = Quadratic(left.H, left.g, active.vector())
        active.steps = self.steps.part(slice(n_old, None))
