"""Poinsot's facts: the curves lie where energy and momentum say, and the cones roll on each other.

Prograde or retrograde (thesis 2.5.1): by energy and momentum, and seen in the motion itself.
"""

import numpy as np
import pytest

from polhode.geometry.lie import Array
from polhode.geometry.rigid_body import propagate
from polhode.simulation.motion.integrate import no_forces
from polhode.simulation.motion.poinsot import (
    circulation_order,
    free_rotation,
    precession_of,
    rotation_states,
    separatrix,
)

OBLATE, PROLATE = np.array([1.7, 1.0, 1.0]), np.array([1.5, 1.5, 0.6])
TRIAXIAL = np.array([1.4, 1.0, 0.7])
MAJOR, MINOR = np.array([1.0, 0.2, 0.3]), np.array([0.1, -0.25, 1.1])
SPINS = {
    "disc": (OBLATE, np.array([0.9, 0.3, -0.2])),
    "disc, backwards": (OBLATE, np.array([-0.9, 0.3, -0.2])),
    "rod": (PROLATE, np.array([-0.2, 0.3, 1.3])),
    "rod, backwards": (PROLATE, np.array([-0.2, 0.3, -1.3])),
    "greatest axis": (TRIAXIAL, MAJOR),
    "least axis": (TRIAXIAL, MINOR),
    "least axis, backwards": (TRIAXIAL, -MINOR),
    "above the separatrix": (TRIAXIAL, np.array([0.3, 1.0, 0.2])),
    "below the separatrix": (TRIAXIAL, np.array([0.2, 1.0, 0.4])),
}


def test_curves_keep_energy_and_momentum_and_the_cones_roll_without_slipping() -> None:
    """2 E = h . w: the herpolhode lies in the invariable plane. Along both curves the rate covers equal ways
    in equal times: no relative motion at the contact."""
    for name in ("greatest axis", "least axis, backwards", "disc"):
        moments, w_P = SPINS[name]
        two_energy, h = w_P**2 @ moments, np.linalg.norm(w_P * moments)
        period_s = precession_of(moments, w_P).spin_period_s
        R_HP, rates_P = free_rotation(moments, w_P, np.linspace(0.0, period_s, 2001))
        rates_H = (R_HP @ rates_P[..., None])[..., 0]
        np.testing.assert_allclose(rates_P[-1], rates_P[0], atol=1e-9)
        np.testing.assert_allclose(rates_P**2 @ moments, two_energy, rtol=1e-10)
        np.testing.assert_allclose(np.linalg.norm(rates_P * moments, axis=1), h, rtol=1e-10)
        np.testing.assert_allclose(rates_H[:, 2], two_energy / h, rtol=1e-9)
        assert rates_H[0, 0] > 0 and rates_H[0, 1] == pytest.approx(0.0, abs=1e-12)
        in_body, in_space = (np.linalg.norm(np.diff(w, axis=0), axis=1) for w in (rates_P, rates_H))
        np.testing.assert_allclose(in_body, in_space, rtol=1e-5)


def test_the_separatrix_has_the_momentum_of_a_spin_about_the_middle_axis() -> None:
    curves = separatrix(TRIAXIAL, 2.0)
    assert len(curves) == 2
    for curve in curves:
        np.testing.assert_allclose(curve**2 @ TRIAXIAL, 2.0, rtol=1e-12)
        np.testing.assert_allclose(np.sum((curve * TRIAXIAL) ** 2, axis=1), 2.0 * TRIAXIAL[1], rtol=1e-12)
    assert separatrix(OBLATE, 2.0) == []


def test_states_under_drag_follow_its_forces() -> None:
    forces = no_forces(TRIAXIAL)._replace(drag_hz=0.1)
    _, h_P = rotation_states(forces, np.array([0.0, 0.0, 1.0]), np.array([0.0, 2.0, 5.0]))
    np.testing.assert_allclose(h_P[:, 2], np.exp([0.0, -0.2, -0.5]), rtol=1e-12)


@pytest.mark.parametrize(("moments", "w_P"), SPINS.values(), ids=SPINS)
def test_sense_and_periods_are_those_of_the_motion(moments: Array, w_P: Array) -> None:
    """Angles of the axis about the momentum and of the body about the axis, followed over three circuits."""
    precession = precession_of(moments, w_P)
    turned, spun, tilt = _euler_angles(moments, w_P, 3 * precession.spin_period_s)
    assert abs(turned) == pytest.approx(6 * np.pi * precession.spin_period_s / precession.precession_period_s)
    assert abs(spun) == pytest.approx(6 * np.pi, rel=1e-6)
    assert precession.direction == ("prograde" if turned * spun > 0 else "retrograde")
    np.testing.assert_allclose(np.rad2deg([tilt.min(), tilt.max()]), precession.wobble_deg, atol=0.02)


def _euler_angles(moments: Array, w_P: Array, duration_s: float) -> tuple[float, float, Array]:
    """Turns of the circled axis about h and of the body about that axis, and the tilt from h (n,) [rad]."""
    order = circulation_order(moments, w_P)
    assert order is not None
    axis_P = np.eye(3)[order[2]] * np.sign(w_P[order[2]])
    t_s = np.linspace(0.0, duration_s, 1201)
    zero = np.zeros(3)
    _, _, R_NP, w = propagate(t_s, zero, zero, np.eye(3), w_P, np.diag(moments), rtol=1e-9)
    h_N = moments * w_P / np.linalg.norm(moments * w_P)
    axis_N = R_NP @ axis_P
    first_N = np.cross(h_N, axis_N[0])
    first_N /= np.linalg.norm(first_N)
    second_N = np.cross(h_N, first_N)
    turned = np.unwrap(np.arctan2(axis_N @ second_N, axis_N @ first_N))
    # The body about its axis: the direction of h seen from the body turns the other way.
    a, b = (np.eye(3)[(order[2] + k) % 3] * s for k, s in ((1, 1.0), (2, np.sign(w_P[order[2]]))))
    h_P = w * moments
    spun = -np.unwrap(np.arctan2(h_P @ b, h_P @ a))
    return turned[-1] - turned[0], spun[-1] - spun[0], np.arccos(axis_N @ h_N)


def test_an_axisymmetric_body_has_the_textbook_periods() -> None:
    w_P = SPINS["rod"][1]
    precession = precession_of(PROLATE, w_P)
    assert precession.precession_period_s == pytest.approx(
        2 * np.pi * PROLATE[0] / np.linalg.norm(PROLATE * w_P)
    )
    assert precession.spin_period_s == pytest.approx(2 * np.pi / (w_P[2] * (1 - PROLATE[2] / PROLATE[0])))


@pytest.mark.parametrize(
    ("moments", "w_P"),
    [
        (TRIAXIAL, [0.0, 1.0, 0.0]),
        (TRIAXIAL, [1.0, 0.0, 0.0]),
        (TRIAXIAL, [0.0, 0.0, 0.0]),
        (np.ones(3), [1.0, 2.0, 3.0]),
        (OBLATE, [0.0, 1.0, 1.0]),
    ],
)
def test_a_steady_spin_has_no_precession(moments: Array, w_P: list[float]) -> None:
    assert precession_of(moments, np.array(w_P)).direction == "none"


def test_on_the_separatrix_there_is_no_sense() -> None:
    """2 E J_middle = h^2: J_1 (J_1 - J_2) w_1^2 = J_3 (J_2 - J_3) w_3^2."""
    J = TRIAXIAL
    w_P = np.array([1.0, 0.7, np.sqrt(J[0] * (J[0] - J[1]) / (J[2] * (J[1] - J[2])))])
    assert precession_of(J, w_P).direction == "none"
    assert precession_of(J, w_P * [1.001, 1, 1]).direction == "retrograde"
    assert precession_of(J, w_P * [0.999, 1, 1]).direction == "prograde"
