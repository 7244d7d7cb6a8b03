"""Torque-free rotation: the kind of precession with its periods, and Poinsot's construction as curves.

Poinsot: the rate circles the axis of greatest inertia where h^2 > 2 E J_middle, and that of least inertia
where it is less. About the greatest axis the body spins against its precession, retrograde, and the body cone
encloses the space cone; about the least axis it is prograde, and the cones lie side by side (thesis 2.5.1).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import ellipk, elliprj

from polhode.geometry.lie import Array, matrix_from_wxyz
from polhode.simulation.motion.integrate import Forces, no_forces, states_at

RELATIVE_TOLERANCE = 1e-9
"""Relative difference below which moments are equal, and the spin is steady or on the separatrix."""


@dataclass(frozen=True)
class Precession:
    """Torque-free motion of a rigid body, averaged over one period of the polhode."""

    direction: Literal["prograde", "retrograde", "none"]
    """None for a steady spin, and on the separatrix"""
    axis: Literal["greatest", "least", "none"]
    """Principal axis about which the rate moves"""
    wobble_deg: tuple[float, float]
    """Least and greatest angle between that axis and the angular momentum"""
    precession_period_s: float
    """Mean period of that axis around the angular momentum"""
    spin_period_s: float
    """Period of the rate around that axis in the body: the period of the polhode"""


def precession_of(moments: Array, w_P: Array) -> Precession:
    """Precession of a free body; moments (3,) sorted from the greatest, w_P (3,) [rad/s] at any time.

    Closed form: Landau and Lifshitz, "Mechanics", section 37; the angle of one period by the complete
    elliptic integral of the third kind in Carlson's form (DLMF 19.25.2).
    """
    order = circulation_order(moments, w_P)
    if order is None:
        return Precession("none", "none", (0.0, 0.0), np.inf, np.inf)
    J1, J2, J3 = moments[order]
    two_energy, h_squared = float(moments @ w_P**2), float(np.sum((moments * w_P) ** 2))
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
    """Principal axes (0, 1, 2), last the one that the rate circles; None if it circles none."""
    h_P = moments * w_P
    two_energy, h_squared = float(moments @ w_P**2), float(h_P @ h_P)
    steady = RELATIVE_TOLERANCE * np.sqrt(h_squared) * np.linalg.norm(w_P)
    if np.linalg.norm(np.cross(h_P, w_P)) <= steady:
        return None
    # With two equal moments the rate circles the third axis.
    if moments[1] - moments[2] <= RELATIVE_TOLERANCE * moments[0]:
        return [2, 1, 0]
    if moments[0] - moments[1] <= RELATIVE_TOLERANCE * moments[0]:
        return [0, 1, 2]
    excess = h_squared / two_energy / moments[1] - 1.0
    if abs(excess) <= RELATIVE_TOLERANCE:
        return None
    return [2, 1, 0] if excess > 0.0 else [0, 1, 2]


def free_rotation(moments: Array, w_P: Array, t_s: Array) -> tuple[Array, Array]:
    """R_HP (n, 3, 3) and w_P (n, 3) of a free body at times (n,), the first of them zero.

    H is inertial: its third axis is along the angular momentum, the first rate in its plane of x and z.
    """
    quaternion, h_P = rotation_states(no_forces(moments), moments * w_P, t_s)
    up = h_P[0] / np.linalg.norm(h_P[0])
    across = w_P - up * (up @ w_P)
    if np.linalg.norm(across) <= 1e-9 * np.linalg.norm(w_P):
        across = np.eye(3)[int(np.argmin(np.abs(up)))]
        across = across - up * (up @ across)
    across = across / np.linalg.norm(across)
    return np.stack([across, np.cross(up, across), up]) @ matrix_from_wxyz(quaternion), h_P / moments


def rotation_states(forces: Forces, h_P: Array, t_s: Array) -> tuple[Array, Array]:
    """Quaternion (n, 4) from the first attitude and momentum h_P (n, 3) at times (n,), under forces."""
    y = states_at(np.concatenate([np.zeros(6), [1.0, 0.0, 0.0, 0.0], h_P]), t_s, forces)
    return y[:, 6:10], y[:, 10:13]


def separatrix(moments: Array, two_energy: float) -> list[Array]:
    """The two curves (n, 3) between the polhodes around the greatest axis and those around the least."""
    J1, J2, J3 = moments
    if J1 == J2 or J2 == J3:
        return []
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    first = np.sqrt(two_energy * (J2 - J3) / (J1 * (J1 - J3))) * np.sin(turn)
    second = np.sqrt(two_energy / J2) * np.cos(turn)
    third = np.sqrt(two_energy * (J1 - J2) / (J3 * (J1 - J3))) * np.sin(turn)
    return [np.stack([first, second, side * third], axis=1) for side in (1.0, -1.0)]
