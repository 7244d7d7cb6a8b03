"""What keeps the steps of Gauss-Newton short, and in which order it is tried."""

from dataclasses import dataclass

import numpy as np

from polhode.backend.problem.inertia import N_INERTIA

DAMPING_FLOOR = 1e-8
MOST_DAMPED, MOST_FIRM = 1e8, 1e5
CONSTANT_SCALE = np.repeat([0.01, 0.1], [3, N_INERTIA])
"""Of com_G [m] and xi."""


@dataclass(frozen=True)
class Damping:
    """What keeps a step short. Either grows when a step is refused, and both are tried.

    Given the constants the states are stiff but almost linear: then only the constants need damping, and the
    states follow them freely. Far from the solution everything may go too far.
    """

    of_all: float = DAMPING_FLOOR
    """In units of the Hessian's diagonal (Marquardt)."""
    of_constants: float = 0.0
    """In units of ``CONSTANT_SCALE``."""

    def more(self, times: int) -> "list[Damping]":
        """What to try when steps were refused so many times; nothing when they cannot be made shorter."""
        firm = max(self.of_constants, 1e-3) * 100.0**times
        stiff = max(self.of_all, 1e-6) * 4.0**times * 2.0 ** (times * (times - 1) // 2)
        firmer = [Damping(of_constants=firm)] if firm < MOST_FIRM else []
        return firmer + ([Damping(of_all=stiff)] if stiff < MOST_DAMPED else [])

    def less(self) -> "Damping":
        """What to begin the next iteration with."""
        of_constants = 0.01 * self.of_constants
        return Damping(max(DAMPING_FLOOR, 0.1 * self.of_all), of_constants if of_constants > 0.01 else 0.0)
