"""Tumbling or spinning: the rate above which station keeping at a target costs too much.

Thesis 1.2, eqs. 1.1-1.12: an inspector that follows a point at a radius from the axis needs a centripetal
force; either the thrusters cannot give it, or it uses more than a share of the inspector's mass as fuel.
"""

from dataclasses import dataclass

import numpy as np

STANDARD_GRAVITY = 9.81
"""[m/s^2], as the thesis rounds it"""
RPM = 2.0 * np.pi / 60.0


@dataclass(frozen=True)
class StationKeeping:
    """An inspector at a fixed position relative to a rotating target."""

    radius_m: float
    """from the spin axis"""
    mass_kg: float
    """of the inspector, with its fuel"""
    force_n: float
    """maximum of its thrusters"""
    isp_s: float
    """specific impulse"""
    duration_s: float
    fuel_fraction: float
    """share of the mass that may be used as fuel, above 0 and below 1"""


@dataclass(frozen=True)
class Threshold:
    """Rates [rad/s] up to which a target counts as tumbling."""

    by_force: float
    """omega_Thresh F, eq. 1.2"""
    by_fuel: float
    """omega_Thresh Mf, eq. 1.10"""

    @property
    def overall(self) -> float:
        """omega_Thresh, eq. 1.12"""
        return min(self.by_force, self.by_fuel)


def threshold(given: StationKeeping) -> Threshold:
    """Eq. 1.12; all values positive, the fuel fraction below 1.

    Raises ValueError for a rate that is too large or too small to be meant.
    """
    by_force = _root([given.force_n], [given.radius_m, given.mass_kg])
    burnt = float(-np.log1p(-given.fuel_fraction))
    by_fuel = _root([STANDARD_GRAVITY, given.isp_s, burnt], [given.radius_m, given.duration_s])
    return Threshold(by_force, by_fuel)


def _root(above: list[float], below: list[float]) -> float:
    """Root of a quotient of products, by logarithms: a product may underflow where the root does not."""
    digits = 0.5 * float(np.log10(above).sum() - np.log10(below).sum())
    # wrong units
    if abs(digits) > 15.0:
        raise ValueError(f"a rate of 10^{digits:.0f} rad/s")
    return float(10.0**digits)


def fuel_share(delta_v_m_s: float, isp_s: float) -> float:
    """Share of the mass that a change of velocity uses as fuel, eq. 1.5."""
    return float(-np.expm1(-delta_v_m_s / (STANDARD_GRAVITY * isp_s)))
