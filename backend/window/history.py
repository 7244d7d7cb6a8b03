"""The first frames of a run as a whole, without their landmarks: as long as the inertia may be a guess.

An arrival cost is expanded about the inertia of its time, and an inertia found late would leave it wrong and
confident. So the states of the first frames stay, in a bounded number; what leaves is only the vision of
frames that are not key frames, condensed to information on the poses, which knows nothing of the inertia.
"""

import numpy as np

from backend.inertia import InertiaForm
from backend.kernels import N_CONSTANTS, N_STATE
from backend.window.active import Active
from backend.window.frame import Frame
from backend.window.links import NO_LINKS, Links, NoiseOfSteps, add_links, link_jacobians, make_links
from backend.window.quadratic import Quadratic, eliminate
from backend.window.vision import N_POSE, Condensed
from polhode.lie import Array
from polhode.records import Ints


class History:
    """States of all frames so far, and what vision that is no longer active said about their poses."""

    def __init__(self, first: Frame, gauge_information: Array) -> None:
        """gauge_information (6,): how firmly G is held at the first frame's pose."""
        self.frames: list[Frame] = [first]
        self._H = np.diag(gauge_information)
        self._b = -gauge_information * first.x[:N_POSE]
        self.steps: Links = NO_LINKS
        """between all frames, as they were solved for last"""

    def append(self, frame: Frame) -> None:
        """A new frame, the window's own object: its state is shared."""
        n = len(self._b)
        H = np.zeros((n + N_POSE, n + N_POSE))
        H[:n, :n] = self._H
        self._H, self._b = H, np.concatenate([self._b, np.zeros(N_POSE)])
        self.frames.append(frame)

    def absorb(self, frames: list[Frame], H: Array, g: Array) -> None:
        """Vision that leaves the window: H, g at the present poses of ``frames`` (6 each)."""
        at = self.pose_entries(frames, N_POSE)
        x = np.concatenate([frame.x[:N_POSE] for frame in frames])
        self._H[np.ix_(at, at)] += H
        self._b[at] += g - H @ x

    def pose_entries(self, frames: list[Frame], stride: int = N_STATE) -> Ints:
        """(6 F,) where the poses of ``frames`` stand among those of all, each ``stride`` long."""
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

    def take(self, x: Array) -> None:
        """Take the states from a vector; the constants are the window's."""
        for n, frame in enumerate(self.frames):
            frame.x[:] = x[N_STATE * n : N_STATE * (n + 1)]

    def past_vision(self, x: Array) -> tuple[Array, Array]:
        """Information (n, n) and gradient (n,) at x of the vision that left, with the hold on G."""
        H, g = np.zeros((len(x), len(x))), np.zeros(len(x))
        at = self.pose_entries(self.frames)
        H[np.ix_(at, at)] = self._H
        g[at] = self._H @ x[at] + self._b
        return H, g

    def vision(self, active: Active, condensed: Condensed) -> Quadratic:
        """All vision, what left and what is active, about the present states (12 N + 8,)."""
        x = self.vector(active.constants)
        H, g = self.past_vision(x)
        at = self.pose_entries(active.frames)
        H[np.ix_(at, at)] += condensed.S
        g[at] += condensed.g
        return Quadratic(H, g, x)

    def links(self, x: Array, J_G: Array, noise: NoiseOfSteps) -> Links:
        """The steps between all frames, whitened at the rates in x."""
        w_G = x[:-N_CONSTANTS].reshape(-1, N_STATE)[:-1, 9:12]
        return make_links(w_G, J_G, np.diff([frame.time_s for frame in self.frames]), noise)

    def arrival(self, active: Active, form: InertiaForm, R_inertia: Array) -> Quadratic:
        """The arrival cost about the window's unknowns: everything but its own vision and dynamics."""
        x = self.vector(active.constants)
        H, g = self.past_vision(x)
        n_old = len(self.frames) - len(active.recent)
        if n_old > 0:
            r, D = link_jacobians(x, self.R_ref, self.steps, form, R_inertia)
            add_links(H, g, r[:n_old], D[:n_old], N_STATE * np.arange(n_old))
        kept = np.concatenate([self.pose_entries(active.keys), np.arange(N_STATE * n_old, len(x))])
        gone = np.setdiff1d(np.arange(len(x)), kept)
        left = eliminate(H, g, gone, kept)
        return Quadratic(left.H, left.g, active.vector())
