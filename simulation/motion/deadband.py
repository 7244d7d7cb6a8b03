"""Limit cycle of a dead-band control: slow drift inside the band, a short thruster pulse at its edge.

The inspector of the thesis moves like this (figures 6-9 to 6-12): nothing acts inside the band; at its edge a
minimum impulse of the thrusters reverses the drift, with a slightly different rate each time.
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array

PULSE_S = 0.1
"""Duration of a pulse [s]; shorter if the band is crossed as quickly."""
RATE_VARIATION = 0.25
"""Largest relative difference of a drift rate from the nominal one."""


@dataclass(frozen=True)
class LimitCycle:
    """One axis: straight lines between corners at the band's edges, rounded during the pulses."""

    corner_s: Array
    """(n,) middle of each pulse [s]"""
    corner_value: Array
    """(n,) value at each pulse: the edge of the band"""
    rate: Array
    """(n + 1,) drift before, between and after the pulses"""
    pulse_s: float

    def value(self, t_s: Array) -> Array:
        """Deviation at times (m,): zero at the first frame, never beyond the band."""
        if len(self.corner_s) == 0:
            return np.zeros(len(t_s))
        index = np.searchsorted(self.corner_s, t_s, side="right")
        # The first line is evaluated from its start, so that it is exactly zero there.
        start_s, start = np.append(0.0, self.corner_s)[index], np.append(0.0, self.corner_value)[index]
        line = start + self.rate[index] * (t_s - start_s)
        since, turn = self._pulse(t_s)
        return np.asarray(line + turn * (0.5 * self.pulse_s - abs(since)) ** 2 / (2.0 * self.pulse_s))

    def slope(self, t_s: Array) -> Array:
        """Its rate at times (m,): continuous."""
        if len(self.corner_s) == 0:
            return np.zeros(len(t_s))
        index = np.searchsorted(self.corner_s, t_s, side="right")
        since, turn = self._pulse(t_s)
        side = np.where(since < 0.0, 1.0, -1.0)
        return np.asarray(self.rate[index] + side * turn * (0.5 * self.pulse_s - abs(since)) / self.pulse_s)

    def _pulse(self, t_s: Array) -> tuple[Array, Array]:
        """Time since the nearest pulse, clipped to the pulse [s], and the change of rate by that pulse."""
        after = np.clip(np.searchsorted(self.corner_s, t_s), 0, len(self.corner_s) - 1)
        before = np.maximum(after - 1, 0)
        closer = abs(t_s - self.corner_s[before]) < abs(t_s - self.corner_s[after])
        nearest = np.where(closer, before, after)
        half = 0.5 * self.pulse_s
        return np.clip(t_s - self.corner_s[nearest], -half, half), np.diff(self.rate)[nearest]


def limit_cycle(half_width: float, rate: float, stop_s: float, rng: np.random.Generator) -> LimitCycle:
    """A cycle in the band [-half_width, half_width], from its centre at time zero until ``stop_s`` [s].

    ``rate`` is the nominal drift per second. The cycle up to any time does not depend on ``stop_s``.
    """
    if half_width == 0.0 or rate == 0.0:
        return LimitCycle(np.zeros(0), np.zeros(0), np.zeros(1), PULSE_S)
    quickest = rate * (1.0 + RATE_VARIATION)
    count = int(np.ceil(stop_s * quickest / (2.0 * half_width))) + 2
    first = 1.0 if rng.random() < 0.5 else -1.0
    signs = first * np.where(np.arange(count + 1) % 2 == 0, 1.0, -1.0)
    rates = signs * rate * (1.0 + RATE_VARIATION * rng.uniform(-1.0, 1.0, count + 1))
    values = signs[:-1] * half_width
    way = np.diff(np.concatenate([[0.0], values]))
    pulse_s = min(PULSE_S, 0.5 * half_width / quickest)
    return LimitCycle(np.cumsum(way / rates[:-1]), values, rates, pulse_s)
