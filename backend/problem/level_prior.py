"""What is known of the level of the disturbances before the data.

The logarithm of each level, of acceleration and of torque, is Gaussian. A free body in orbit has almost none,
one in the air of a laboratory 1e-6 (thesis eqs. 6.14, 6.15): the prior is broad. The stated level is one
standard deviation above its median, exceeded by one target in six.
"""

from dataclasses import dataclass

import numpy as np

from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array

STEP = 0.25
"""Step of the grid [decades]: the evidence of a long sequence is smooth over it."""
FLOOR_PSD, CEILING_PSD = 1e-12, 1e-2
"""Below the floor nothing changes within a minute: the evidence there is that of the floor; above the ceiling
the body is not free."""


@dataclass(frozen=True)
class LevelPrior:
    """Gaussian in the logarithm of each level."""

    stated: tuple[float, float]
    """accel_psd and torque_psd, one standard deviation above their medians"""
    decades: float
    """Standard deviation of log10"""

    @staticmethod
    def of(config: Backend) -> "LevelPrior":
        """As the configuration states it."""
        return LevelPrior((config.accel_psd, config.torque_psd), config.level_decades)

    def minus_log(self, decades: Array) -> Array:
        """Of levels (n,), in decades from the stated one; without its constant."""
        return np.asarray(0.5 * (decades / self.decades + 1.0) ** 2)

    def level(self, axis: int, steps: int) -> float:
        """A level of the grid, moved to the floor or the ceiling where it is beyond."""
        stated = self.stated[axis]
        wanted = stated * 10.0 ** (STEP * steps)
        return float(np.clip(wanted, min(FLOOR_PSD, stated), max(CEILING_PSD, stated)))
