"""How a free body wobbles: the axis that its rate circles, the sense of the precession, the periods.

Poinsot: the rate circles the axis of greatest inertia where h^2 > 2 E J_middle, and that of least inertia
where it is less. About the greatest axis the body spins against its precession, retrograde, and the body cone
encloses the space cone; about the least axis it is prograde, and the cones lie side by side (thesis 2.5.1).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import ellipk, elliprj

from polhode.lie import Array

Sense = Literal["prograde", "retrograde", "none"]
SAME = 1e-9
"""Relative difference below which moments are equal, and the spin is steady or on the separatrix."""


@dataclass(frozen=True)
class Precession:
    """Torque-free motion of a rigid body, averaged over one circuit of the polhode."""

    sense: Sense
    """None for a steady spin, and on the separatrix"""
    axis: Literal["greatest", "least", "none"]
    """Principal axis that the rate circles"""
    wobble_deg: tuple[float, float]
    """Least and greatest angle between that axis and the angular momentum"""
    precession_period_s: float
    """Mean time in which the axis goes around the momentum once"""
    spin_period_s: float
    """Time in which the rate goes around the axis once, in the body: the polhode's period"""


NO_PRECESSION = Precession("none", "none", (0.0, 0.0), np.inf, np.inf)


def precession_of(moments: Array, w_P: Array) -> Precession:
    """Precession of a free body; moments (3,) sorted from the greatest, w_P (3,) [rad/s] at any time.

    Closed form: Landau and Lifshitz, "Mechanics", section 37; the angle of a circuit by the complete elliptic
    integral of the third kind in Carlson's form (DLMF 19.25.2).
    """
    order = circulation_order(moments, w_P)
    if order is None:
        return NO_PRECESSION
    J1, J2, J3 = moments[order]
    two_energy, h_squared = _energy_and_momentum(moments, w_P)
    h = np.sqrt(h_squared)
    d3, d1 = two_energy * J3 - h_squared, h_squared - two_energy * J1
    rate = np.sqrt((J3 - J2) * d1 / (J1 * J2 * J3))
    m = (J2 - J1) * d3 / ((J3 - J2) * d1)
    period_s = 4.0 * ellipk(m) / rate
    largest = d1 * J3 / (J3 - J1)
    across = h_squared - largest
    n = -m * largest / across
    third_kind = ellipk(m) + n / 3.0 * elliprj(0.0, 1.0 - m, 1.0, 1.0 - n)
    turned = h * period_s / J3 + h * (two_energy - h_squared / J3) / (across * rate) * 4.0 * third_kind
    cosines = np.sqrt(np.array([largest, largest * (1.0 - m)]) / h_squared)
    least_deg, greatest_deg = np.rad2deg(np.arccos(np.minimum(cosines, 1.0)))
    about_greatest = order[2] == 0
    return Precession(
        "retrograde" if about_greatest else "prograde",
        "greatest" if about_greatest else "least",
        (float(least_deg), float(greatest_deg)),
        float(2.0 * np.pi * period_s / turned),
        float(period_s),
    )


def circulation_order(moments: Array, w_P: Array) -> list[int] | None:
    """Principal axes (0, 1, 2) with the one that the rate circles last; None where it circles none."""
    two_energy, h_squared = _energy_and_momentum(moments, w_P)
    steady = np.linalg.norm(np.cross(moments * w_P, w_P)) <= SAME * np.sqrt(h_squared) * np.linalg.norm(w_P)
    if steady:
        return None
    # Of two equal moments neither axis is circled: the rate circles the third.
    if moments[1] - moments[2] <= SAME * moments[0]:
        return [2, 1, 0]
    if moments[0] - moments[1] <= SAME * moments[0]:
        return [0, 1, 2]
    excess = h_squared / two_energy / moments[1] - 1.0
    if abs(excess) <= SAME:
        return None
    return [2, 1, 0] if excess > 0.0 else [0, 1, 2]


def _energy_and_momentum(moments: Array, w_P: Array) -> tuple[float, float]:
    """Twice the energy [J], and the square of the angular momentum [(N m s)^2]."""
    return float(moments @ w_P**2), float(np.sum((moments * w_P) ** 2))
