"""What the window holds: key poses, recent states, constants, and the arrival cost about all of them."""

from dataclasses import dataclass, field

import numpy as np

from backend.inertia import InertiaForm
from backend.kernels import N_CONSTANTS, N_STATE
from backend.window.frame import Frame, states_of
from backend.window.links import NO_LINKS, Links, link_jacobians
from backend.window.quadratic import Quadratic, eliminate
from backend.window.vision import N_POSE
from polhode.lie import Array
from polhode.records import Ints

NOTHING = Quadratic(np.zeros((0, 0)), np.zeros(0), np.zeros(0))


@dataclass
class Active:
    """The unknowns as one vector: 6 of each key pose (p_NG, theta), 12 of each recent state, com_G, xi."""

    keys: list[Frame] = field(default_factory=list)
    recent: list[Frame] = field(default_factory=list)
    links: Links = NO_LINKS
    """between the recent states; the history has its own"""
    constants: Array = field(default_factory=lambda: np.zeros(N_CONSTANTS))
    """(8,) com_G, xi"""
    arrival: Quadratic = NOTHING
    """information of all that left, without the weak prior; empty as long as the whole history is kept"""

    @property
    def frames(self) -> list[Frame]:
        """Keys, then recent ones: in the order of time."""
        return [*self.keys, *self.recent]

    @property
    def n_keys(self) -> int:
        """Entries of the vector that belong to keys."""
        return N_POSE * len(self.keys)

    @property
    def pose_entries(self) -> Ints:
        """(6 F,) where the poses stand in the vector."""
        start = self.n_keys + N_STATE * np.arange(len(self.recent))
        of_recent = (start[:, None] + np.arange(N_POSE)).ravel()
        return np.concatenate([np.arange(self.n_keys), of_recent])

    @property
    def R_ref(self) -> Array:
        """(W, 3, 3) of the recent states."""
        return np.stack([frame.R_ref for frame in self.recent])

    def vector(self) -> Array:
        """The unknowns (6 K + 12 W + 8,)."""
        of_keys = np.concatenate([np.zeros(0), *(frame.x[:N_POSE] for frame in self.keys)])
        return np.concatenate([of_keys, states_of(self.recent).ravel(), self.constants])

    def take(self, x: Array) -> None:
        """Take the unknowns from a vector."""
        for n, frame in enumerate(self.keys):
            frame.x[:N_POSE] = x[N_POSE * n : N_POSE * (n + 1)]
        for n, frame in enumerate(self.recent):
            start = self.n_keys + N_STATE * n
            frame.x[:] = x[start : start + N_STATE]
        self.constants = x[-N_CONSTANTS:].copy()

    def make_room(self) -> None:
        """A state was added before the constants, of which the arrival cost knows nothing."""
        n = len(self.arrival.g) - N_CONSTANTS
        old = np.r_[0:n, n + N_STATE : n + N_STATE + N_CONSTANTS]
        size = n + N_STATE + N_CONSTANTS
        H, g, x0 = np.zeros((size, size)), np.zeros(size), self.vector()
        H[np.ix_(old, old)], g[old], x0[old] = self.arrival.H, self.arrival.g, self.arrival.x0
        self.arrival = Quadratic(H, g, x0)

    def absorb(self, parts: list[tuple[Ints, Array, Array]], gone: Ints) -> None:
        """Add information (entries, H, g at the present vector) to the arrival cost, then eliminate entries.

        The caller takes what is gone out of the frames.
        """
        x = self.vector()
        H, g = self.arrival.H.copy(), self.arrival.gradient(x)
        for entries, more, gradient in parts:
            H[np.ix_(entries, entries)] += more
            g[entries] += gradient
        kept = np.setdiff1d(np.arange(len(g)), gone)
        left = eliminate(H, g, gone, kept)
        self.arrival = Quadratic(left.H, left.g, x[kept])

    def oldest_step(self, form: InertiaForm, R_inertia: Array) -> tuple[Ints, Array, Array]:
        """The dynamics from the oldest recent state to the next: entries, information, gradient."""
        x, start = self.vector(), self.n_keys
        both = np.r_[start : start + 2 * N_STATE, len(x) - N_CONSTANTS : len(x)]
        first = self.links.part(slice(0, 1))
        r, D = link_jacobians(x[both], self.R_ref[:2], first, form, R_inertia)
        return both, D[0].T @ D[0], D[0].T @ r[0]

    def shift(self) -> None:
        """The oldest state becomes a key."""
        self.keys.append(self.recent.pop(0))
