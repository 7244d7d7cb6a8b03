"""Poinsot's facts: the curves lie where energy and momentum say, and the cones roll on each other."""

import numpy as np
import pytest

from polhode.lie import Array
from polhode.simulation.motion.integrate import free_of_forces
from polhode.simulation.motion.poinsot import (
    Poinsot,
    free_rotation,
    poinsot,
    polhodes,
    rotation_states,
    separatrix,
)

TRIAXIAL, DISC = np.array([1.4, 1.0, 0.7]), np.array([1.7, 1.0, 1.0])
CASES = {
    "about the greatest axis": (TRIAXIAL, np.array([1.0, 0.2, 0.3])),
    "about the least axis": (TRIAXIAL, np.array([0.1, -0.25, -1.1])),
    "disc": (DISC, np.array([0.9, 0.3, -0.2])),
}


@pytest.fixture(scope="module", params=list(CASES.values()), ids=list(CASES))
def geometry(request: pytest.FixtureRequest) -> Poinsot:
    return poinsot(*request.param)


def test_the_polhode_is_closed_and_keeps_energy_and_momentum(geometry: Poinsot) -> None:
    w = geometry.polhode_P
    np.testing.assert_allclose(w[-1], w[0], atol=1e-9)
    np.testing.assert_allclose(w**2 @ geometry.moments, geometry.two_energy, rtol=1e-10)
    h = np.linalg.norm(w * geometry.moments, axis=1)
    np.testing.assert_allclose(h, h[0], rtol=1e-10)


def test_the_herpolhode_lies_in_the_invariable_plane(geometry: Poinsot) -> None:
    """2 E = h . w: the rate's component along the momentum is constant."""
    h = np.linalg.norm(geometry.polhode_P[0] * geometry.moments)
    np.testing.assert_allclose(geometry.herpolhode_H[:, 2], geometry.two_energy / h, rtol=1e-9)


def test_the_cones_touch_along_the_rate_at_the_first_frame(geometry: Poinsot) -> None:
    np.testing.assert_allclose(geometry.body_cone_H[0], geometry.herpolhode_H[0], atol=1e-12)
    assert geometry.herpolhode_H[0, 0] > 0
    assert geometry.herpolhode_H[0, 1] == pytest.approx(0.0, abs=1e-12)


def test_the_body_cone_rolls_without_slipping() -> None:
    """Along both curves the rate covers equal ways in equal times: no relative motion at the contact."""
    for moments, w_P in CASES.values():
        R_HP, rates_P = free_rotation(moments, w_P, np.linspace(0.0, 5.0, 2001))
        in_body = np.linalg.norm(np.diff(rates_P, axis=0), axis=1)
        rates_H = (R_HP @ rates_P[..., None])[..., 0]
        in_space = np.linalg.norm(np.diff(rates_H, axis=0), axis=1)
        np.testing.assert_allclose(in_body, in_space, rtol=1e-5)


def test_the_axis_goes_around_the_momentum_once(geometry: Poinsot) -> None:
    t_s = np.linspace(0.0, geometry.precession.precession_period_s, 361)
    R_HP, rates_P = free_rotation(geometry.moments, geometry.polhode_P[0], t_s)
    np.testing.assert_allclose(geometry.around_H, (R_HP @ rates_P[..., None])[..., 0], atol=1e-12)
    axis_H = R_HP @ geometry.axis_P
    turned = np.unwrap(np.arctan2(axis_H[:, 1], axis_H[:, 0]))[-1] - np.arctan2(axis_H[0, 1], axis_H[0, 0])
    assert turned == pytest.approx(2 * np.pi, rel=0.05)
    assert geometry.axis_P @ geometry.polhode_P[0] > 0


@pytest.mark.parametrize("moments", [TRIAXIAL, DISC])
def test_other_polhodes_lie_on_the_ellipsoid_with_one_momentum_each(moments: Array) -> None:
    curves = polhodes(moments, 2.0, 3)
    assert len(curves) == (12 if moments is TRIAXIAL else 6)
    for curve in curves:
        np.testing.assert_allclose(curve**2 @ moments, 2.0, rtol=1e-12)
        h = np.linalg.norm(curve * moments, axis=1)
        np.testing.assert_allclose(h, h[0], rtol=1e-9)


def test_the_separatrix_has_the_momentum_of_a_spin_about_the_middle_axis() -> None:
    curves = separatrix(TRIAXIAL, 2.0)
    assert len(curves) == 2
    for curve in curves:
        np.testing.assert_allclose(curve**2 @ TRIAXIAL, 2.0, rtol=1e-12)
        np.testing.assert_allclose(np.sum((curve * TRIAXIAL) ** 2, axis=1), 2.0 * TRIAXIAL[1], rtol=1e-12)
    assert separatrix(DISC, 2.0) == []


def test_a_steady_spin_stays_where_it_is() -> None:
    still = poinsot(TRIAXIAL, np.array([0.0, 0.0, 1.3]))
    assert still.precession.sense == "none"
    np.testing.assert_allclose(
        still.herpolhode_H, np.tile([0, 0, 1.3], (len(still.herpolhode_H), 1)), atol=1e-12
    )
    np.testing.assert_allclose(still.axis_P, [0, 0, 1], atol=1e-15)


def test_states_under_drag_follow_its_forces() -> None:
    forces = free_of_forces(TRIAXIAL)._replace(drag_hz=0.1)
    _, h_P = rotation_states(forces, np.array([0.0, 0.0, 1.0]), np.array([0.0, 2.0, 5.0]))
    np.testing.assert_allclose(h_P[:, 2], np.exp([0.0, -0.2, -0.5]), rtol=1e-12)
