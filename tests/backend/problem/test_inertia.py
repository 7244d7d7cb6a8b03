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


@pytest.mark.parametrize("name", FORMS)
def test_any_five_numbers_give_a_possible_body_and_any_body_has_five_numbers(name: str) -> None:
    form, rng = FORMS[name], np.random.default_rng(0)
    for xi in rng.normal(size=(50, 5)) * 1.5:
        moments = np.linalg.eigvalsh(inertia_from_second_moments(form.second_moments(xi, np.eye(3))))
        assert moments[0] > 0.0 and moments[0] + moments[1] > moments[2] * (1.0 - 1e-12)
    M = rng.normal(size=(3, 3))
    second = M @ M.T + 0.2 * np.eye(3)
    second /= np.linalg.det(second) ** (1 / 3)
    np.testing.assert_allclose(form.second_moments(*form.coordinates(second)), second, atol=1e-12)
    # a needle thinner than numbers can tell gets a thickness
    R = Rotation.random(rng=np.random.default_rng(3)).as_matrix()
    needle = form.second_moments(*form.coordinates(R @ np.diag([1.0, 1e-13, -1e-17]) @ R.T))
    values = np.linalg.eigvalsh(needle)
    assert values[0] > 0.0 and np.prod(values) == pytest.approx(1.0, rel=1e-6)
    assert values[2] / values[0] < 1e8


@pytest.mark.parametrize("name", FORMS)
def test_the_derivative_matches_finite_differences(name: str) -> None:
    form, rng = FORMS[name], np.random.default_rng(3)
    xi, R_ref = rng.normal(size=5) * 0.4, Rotation.random(rng=rng).as_matrix()
    second, J = form.derivative(xi, R_ref), inertia_derivative(form, xi, R_ref)
    for n, e in enumerate(1e-6 * np.eye(5)):
        ends = [form.second_moments(xi + s * e, R_ref) for s in (1.0, -1.0)]
        np.testing.assert_allclose(second[n], (ends[0] - ends[1]) / 2e-6, atol=1e-8)
        inertias = [inertia_from_second_moments(end) for end in ends]
        np.testing.assert_allclose(J[n], (inertias[0] - inertias[1]) / 2e-6, atol=1e-8)


def test_second_moments_of_a_solid_box_and_its_sorted_right_handed_axes() -> None:
    a, b, c = 0.3, 0.2, 0.1
    J = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 12.0
    expected = np.diag([a * a, b * b, c * c])
    expected /= np.linalg.det(expected) ** (1 / 3)
    np.testing.assert_allclose(second_moments_from_inertia(J), expected, rtol=1e-12)
    R = Rotation.random(rng=np.random.default_rng(2)).as_matrix()
    moments, R_GP = principal_axes(R @ np.diag([1.0, 2.0, 1.6]) @ R.T)
    np.testing.assert_allclose(moments, [2.0 / 1.6, 1.0, 1.0 / 1.6])
    assert np.linalg.det(R_GP) == pytest.approx(1.0)
    np.testing.assert_allclose(np.abs(R_GP.T @ R), [[0, 1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-9)
