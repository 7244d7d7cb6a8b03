"""Prograde or retrograde (thesis 2.5.1): by energy and momentum, and seen in the motion itself."""

import numpy as np
import pytest

from polhode.lie import Array
from polhode.rigid_body import propagate
from polhode.simulation.motion.precession import circulation_order, precession_of

OBLATE, PROLATE = np.array([1.7, 1.0, 1.0]), np.array([1.5, 1.5, 0.6])
TRIAXIAL = np.array([1.4, 1.0, 0.7])
MAJOR, MINOR = np.array([1.0, 0.2, 0.3]), np.array([0.1, -0.25, 1.1])
CASES = {
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


@pytest.mark.parametrize(("moments", "sense"), [(OBLATE, "retrograde"), (PROLATE, "prograde")])
def test_a_disc_precesses_retrograde_and_a_rod_prograde(moments: Array, sense: str) -> None:
    for seed in range(20):
        w_P = np.random.default_rng(seed).normal(size=3)
        assert precession_of(moments, w_P).sense == sense


@pytest.mark.parametrize(("moments", "w_P"), CASES.values(), ids=CASES)
def test_sense_and_periods_are_those_of_the_motion(moments: Array, w_P: Array) -> None:
    """Angles of the axis about the momentum and of the body about the axis, followed over three circuits."""
    precession = precession_of(moments, w_P)
    turned, spun, tilt = _euler_angles(moments, w_P, 3 * precession.spin_period_s)
    assert abs(turned) == pytest.approx(6 * np.pi * precession.spin_period_s / precession.precession_period_s)
    assert abs(spun) == pytest.approx(6 * np.pi, rel=1e-6)
    assert precession.sense == ("prograde" if turned * spun > 0 else "retrograde")
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


@pytest.mark.parametrize("name", ["disc", "rod"])
def test_the_body_cone_of_a_disc_encloses_the_space_cone_and_a_rods_lies_beside_it(name: str) -> None:
    moments, w_P = CASES[name]
    axis_P = np.array([1.0, 0, 0]) if name == "disc" else np.array([0, 0, 1.0])
    h_P = moments * w_P
    tilt, body, space = _angle(axis_P, h_P), _angle(axis_P, w_P), _angle(h_P, w_P)
    if name == "disc":
        assert tilt == pytest.approx(body - space)
        assert body > space
    else:
        assert tilt == pytest.approx(body + space)


def _angle(a: Array, b: Array) -> float:
    return float(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))


def test_an_axisymmetric_body_has_the_textbook_periods() -> None:
    w_P = CASES["rod"][1]
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
    assert precession_of(moments, np.array(w_P)).sense == "none"


def test_on_the_separatrix_there_is_no_sense() -> None:
    """2 E J_middle = h^2: J_1 (J_1 - J_2) w_1^2 = J_3 (J_2 - J_3) w_3^2."""
    J = TRIAXIAL
    w_P = np.array([1.0, 0.7, np.sqrt(J[0] * (J[0] - J[1]) / (J[2] * (J[1] - J[2])))])
    assert precession_of(J, w_P).sense == "none"
    assert precession_of(J, w_P * [1.001, 1, 1]).sense == "retrograde"
    assert precession_of(J, w_P * [0.999, 1, 1]).sense == "prograde"
