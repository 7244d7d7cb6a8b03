"""Both forms of the inertia are physical everywhere and describe the same bodies."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polhode.backend.problem.inertia import (
    FORMS,
    inertia_derivative,
    inertia_from_second_moments,
    principal_axes,
    second_moments_from_inertia,
)


@pytest.mark.parametrize("name", ["second_moments", "ratios_axes"])
def test_any_five_numbers_give_a_possible_body(name: str) -> None:
    rng = np.random.default_rng(0)
    for xi in rng.normal(size=(50, 5)) * 1.5:
        J = inertia_from_second_moments(FORMS[name].second_moments(xi, np.eye(3)))
        moments = np.linalg.eigvalsh(J)
        assert moments[0] > 0.0
        assert moments[0] + moments[1] > moments[2] * (1.0 - 1e-12)


@pytest.mark.parametrize("name", ["second_moments", "ratios_axes"])
def test_coordinates_are_the_inverse(name: str) -> None:
    rng = np.random.default_rng(1)
    M = rng.normal(size=(3, 3))
    second = M @ M.T + 0.2 * np.eye(3)
    second /= np.linalg.det(second) ** (1 / 3)
    np.testing.assert_allclose(
        FORMS[name].second_moments(*FORMS[name].coordinates(second)), second, atol=1e-12
    )


def test_second_moments_of_a_solid_box_come_back_from_its_inertia() -> None:
    a, b, c = 0.3, 0.2, 0.1
    J = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 12.0
    second = second_moments_from_inertia(J)
    expected = np.diag([a * a, b * b, c * c])
    np.testing.assert_allclose(second, expected / np.linalg.det(expected) ** (1 / 3), rtol=1e-12)


def test_principal_axes_are_sorted_and_right_handed() -> None:
    R = Rotation.random(rng=np.random.default_rng(2)).as_matrix()
    moments, R_GP = principal_axes(R @ np.diag([1.0, 2.0, 1.6]) @ R.T)
    np.testing.assert_allclose(moments, [2.0 / 1.6, 1.0, 1.0 / 1.6])
    assert np.linalg.det(R_GP) == pytest.approx(1.0)
    np.testing.assert_allclose(np.abs(R_GP.T @ R), [[0, 1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("name", ["second_moments", "ratios_axes"])
def test_the_derivative_matches_finite_differences(name: str) -> None:
    form, rng = FORMS[name], np.random.default_rng(3)
    xi, R_ref = rng.normal(size=5) * 0.4, Rotation.random(rng=rng).as_matrix()
    for n, e in enumerate(1e-6 * np.eye(5)):
        numeric = (form.second_moments(xi + e, R_ref) - form.second_moments(xi - e, R_ref)) / 2e-6
        np.testing.assert_allclose(form.derivative(xi, R_ref)[n], numeric, atol=1e-8)
    trace = np.trace(form.derivative(xi, R_ref), axis1=1, axis2=2)
    np.testing.assert_allclose(
        np.trace(inertia_derivative(form, xi, R_ref), axis1=1, axis2=2), 2.0 * trace, atol=1e-12
    )


@pytest.mark.parametrize("name", ["second_moments", "ratios_axes"])
def test_a_needle_thinner_than_numbers_can_tell_gets_a_thickness(name: str) -> None:
    R = Rotation.random(rng=np.random.default_rng(3)).as_matrix()
    needle = R @ np.diag([1.0, 1e-13, -1e-17]) @ R.T
    second = FORMS[name].second_moments(*FORMS[name].coordinates(needle))
    values = np.linalg.eigvalsh(second)
    assert values[0] > 0.0 and np.prod(values) == pytest.approx(1.0, rel=1e-6)
    assert values[2] / values[0] < 1e8
