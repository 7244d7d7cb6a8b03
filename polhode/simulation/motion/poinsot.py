"""Torque-free rotation: the kind of precession with its periods, and Poinsot's construction as curves.

Poinsot: the rate circles the axis of greatest inertia where h^2 > 2 E J_middle, and that of least inertia
where it is less. About the greatest axis the body spins against its precession, retrograde, and the body cone
encloses the space cone; about the least axis it is prograde, and the cones lie side by side (thesis 2.5.1).

H is an inertial frame with its third axis along the angular momentum and the rate at the first frame in its
plane of x and z. The mantles of the body cone and the space cone are the lines from the centre of mass to the
polhode and the herpolhode, which are curves of angular rates.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import ellipk, elliprj

from polhode.geometry.lie import Array, matrix_from_wxyz
from polhode.simulation.motion.integrate import Forces, no_forces, states_at

PrecessionDirection = Literal["prograde", "retrograde", "none"]
RELATIVE_TOLERANCE = 1e-9
"""Relative difference below which moments are equal, and the spin is steady or on the separatrix."""


CURVE_POINTS = 361
"""Points of a closed curve."""
STEADY_S = 10.0
"""Duration of the curves for a spin without precession [s]."""


@dataclass(frozen=True)
class Precession:
    """Torque-free motion of a rigid body, averaged over one period of the polhode."""

    direction: PrecessionDirection
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
    """Principal axes (0, 1, 2), last the one that the rate circles; None if it circles none."""
    two_energy, h_squared = _energy_and_momentum(moments, w_P)
    steady = np.linalg.norm(np.cross(moments * w_P, w_P)) <= RELATIVE_TOLERANCE * np.sqrt(
        h_squared
    ) * np.linalg.norm(w_P)
    if steady:
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


def _energy_and_momentum(moments: Array, w_P: Array) -> tuple[float, float]:
    """Twice the energy [J], and the square of the angular momentum [(N m s)^2]."""
    return float(moments @ w_P**2), float(np.sum((moments * w_P) ** 2))


@dataclass(frozen=True)
class Poinsot:
    """Geometry of the free motion from an initial state. Rates in rad/s."""

    moments: Array
    """(3,) sorted, greatest first [kg m^2]"""
    two_energy: float
    """[J]"""
    precession: Precession
    axis_P: Array
    """(3,) unit: the principal axis that the rate circles, on its side; the rate itself if it is steady"""
    R_HP: Array
    """(3, 3) at the first frame"""
    polhode_P: Array
    """(n, 3) rate in the body over one period"""
    herpolhode_H: Array
    """(m, 3) rate in H over many periods, from the first frame on"""
    around_H: Array
    """(k, 3) its beginning: one revolution of the axis about the momentum"""

    @property
    def body_cone_H(self) -> Array:
        """(n, 3) edge of the body cone, where it is at the first frame."""
        return np.asarray(self.polhode_P @ self.R_HP.T)

    @property
    def semi_axes(self) -> Array:
        """(3,) of the ellipsoid of rates of the same energy."""
        return np.asarray(np.sqrt(self.two_energy / self.moments))


def poinsot(moments: Array, w_P: Array, circuits: int = 12) -> Poinsot:
    """The geometry of a free motion; moments (3,) sorted [kg m^2], w_P (3,) [rad/s], not zero."""
    precession = precession_of(moments, w_P)
    steady = precession.direction == "none"
    period_s = STEADY_S if steady else precession.spin_period_s
    once_s = STEADY_S if steady else precession.precession_period_s
    long_s = max(circuits * period_s, once_s)
    around_t = np.linspace(0.0, once_s, CURVE_POINTS)
    later_t = np.linspace(once_s, long_s, int(np.clip((long_s - once_s) / around_t[1], 2, 40 * CURVE_POINTS)))
    R_HP, rates_P = free_rotation(moments, w_P, np.concatenate([around_t, later_t[1:]]))
    herpolhode_H = (R_HP @ rates_P[..., None])[..., 0]
    polhode_P = free_rotation(moments, w_P, np.linspace(0.0, period_s, CURVE_POINTS))[1]
    return Poinsot(
        moments,
        float(moments @ w_P**2),
        precession,
        _circled_axis(moments, w_P),
        R_HP[0],
        polhode_P,
        herpolhode_H,
        herpolhode_H[:CURVE_POINTS],
    )


def free_rotation(moments: Array, w_P: Array, t_s: Array) -> tuple[Array, Array]:
    """R_HP (n, 3, 3) and w_P (n, 3) of a free body at times (n,), the first of them zero."""
    quaternion, h_P = rotation_states(no_forces(moments), moments * w_P, t_s)
    return _momentum_frame(moments * w_P, w_P) @ matrix_from_wxyz(quaternion), h_P / moments


def rotation_states(forces: Forces, h_P: Array, t_s: Array) -> tuple[Array, Array]:
    """Quaternion (n, 4) from the first attitude and momentum h_P (n, 3) at times (n,), under forces."""
    y = states_at(np.concatenate([np.zeros(6), [1.0, 0.0, 0.0, 0.0], h_P]), t_s, forces)
    return y[:, 6:10], y[:, 10:13]


def polhodes(moments: Array, two_energy: float, count: int) -> list[Array]:
    """Closed polhodes (n, 3) of one energy all over the ellipsoid, ``count`` around each end of two axes."""
    curves = []
    for order in ([2, 1, 0], [0, 1, 2]):
        middle, last = moments[order[1]], moments[order[2]]
        if middle == last:
            continue
        for step in range(1, count + 1):
            # Evenly over the angle between the axis and the separatrix.
            share = np.sin(0.5 * np.pi * step / (count + 1)) ** 2
            h_squared = two_energy * (last + (middle - last) * share)
            curve = _polhode(moments[order], two_energy, h_squared)
            for side in (1.0, -1.0):
                points = np.empty_like(curve)
                points[:, order] = curve * [1.0, 1.0, side]
                curves.append(points)
    return curves


def separatrix(moments: Array, two_energy: float) -> list[Array]:
    """The two curves (n, 3) between the polhodes around the greatest axis and those around the least."""
    J1, J2, J3 = moments
    if J1 == J2 or J2 == J3:
        return []
    turn = np.linspace(0.0, 2.0 * np.pi, CURVE_POINTS)
    first = np.sqrt(two_energy * (J2 - J3) / (J1 * (J1 - J3))) * np.sin(turn)
    second = np.sqrt(two_energy / J2) * np.cos(turn)
    third = np.sqrt(two_energy * (J1 - J2) / (J3 * (J1 - J3))) * np.sin(turn)
    return [np.stack([first, second, side * third], axis=1) for side in (1.0, -1.0)]


def _polhode(J: Array, two_energy: float, h_squared: float) -> Array:
    """One polhode around the last of the axes, moments (3,) in their order -> (n, 3)."""
    d3 = two_energy * J[2] - h_squared
    turn = np.linspace(0.0, 2.0 * np.pi, CURVE_POINTS)
    first = np.sqrt(d3 / (J[0] * (J[2] - J[0]))) * np.cos(turn)
    second = np.sqrt(d3 / (J[1] * (J[2] - J[1]))) * np.sin(turn)
    third = np.sqrt(np.maximum(two_energy - J[0] * first**2 - J[1] * second**2, 0.0) / J[2])
    return np.stack([first, second, third], axis=1)


def _circled_axis(moments: Array, w_P: Array) -> Array:
    order = circulation_order(moments, w_P)
    if order is None:
        return np.asarray(w_P / np.linalg.norm(w_P))
    return np.asarray(np.eye(3)[order[2]] * np.sign(w_P[order[2]]))


def _momentum_frame(h_P: Array, w_P: Array) -> Array:
    """R_HP (3, 3) at the first frame."""
    up = h_P / np.linalg.norm(h_P)
    across = w_P - up * (up @ w_P)
    if np.linalg.norm(across) <= 1e-9 * np.linalg.norm(w_P):
        across = np.eye(3)[int(np.argmin(np.abs(up)))]
        across = across - up * (up @ across)
    across = across / np.linalg.norm(across)
    return np.stack([across, np.cross(up, across), up])
