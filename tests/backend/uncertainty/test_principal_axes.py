"""Ratios and axes of nearly equal moments against eigenvalues of drawn inertias."""

import numpy as np
import pytest

from polhode.backend.problem.inertia import FORMS, inertia_from_second_moments, second_moments_from_inertia
from polhode.backend.problem.iterate import Iterate
from polhode.backend.uncertainty.principal_axes import (
    AxesDerivative,
    axes_derivative,
    free_axis_covariance,
    nonlinear_turns,
    ratio_covariance,
)
from polhode.geometry.lie import Array, exp_so3, hat

FORM = FORMS["second_moments"]
R = exp_so3([0.3, -0.4, 0.8])


def at(moments: list[float]) -> tuple[Iterate, AxesDerivative]:
    xi, R_inertia = FORM.coordinates(second_moments_from_inertia(R @ np.diag(moments) @ R.T))
    zero = np.zeros((1, 3))
    iterate = Iterate(zero, np.eye(3)[None], zero, zero, np.zeros(3), xi, R_inertia, zero)
    return iterate, axes_derivative(FORM, iterate)


def exact_ratios(iterate: Iterate, change: Array) -> Array:
    """k1, k2 (n, 2) of the inertias changed by xi (n, 5)."""
    J = [inertia_from_second_moments(FORM.second_moments(iterate.xi + d, iterate.R_inertia)) for d in change]
    moments = np.linalg.eigvalsh(np.array(J))[:, ::-1]
    return np.asarray(np.log(moments[:, :2] / moments[:, 1:]))


@pytest.mark.parametrize("gap", [0.0, 0.002, 0.02])
def test_repelling_moments_have_the_spread_of_drawn_ones(gap: float) -> None:
    iterate, derivative = at([1.0 + gap, 1.0, 0.7])
    cov = np.diag([1.0, 2.0, 1.5, 0.5, 1.0]) * 4e-6
    here = np.log(derivative.moments[:2] / derivative.moments[1:])
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(5), cov, 4000)
    expected = np.mean((exact_ratios(iterate, drawn) - here) ** 2, axis=0)
    found = np.diag(ratio_covariance(derivative, cov))
    np.testing.assert_allclose(np.sqrt(found), np.sqrt(expected), rtol=0.06)


def test_a_small_gap_that_is_well_known_alone_is_not_a_well_known_ratio() -> None:
    _, derivative = at([1.005, 1.0, 0.7])
    inverse = np.linalg.inv(np.vstack([derivative.ratios, derivative.axes]))
    # k1 to 1e-4, but the axes may turn by 0.3 rad: a product of inertia of 0.0015
    cov = inverse @ np.diag([1e-4, 1e-3, 1e-3, 1e-3, 0.3]) ** 2 @ inverse.T
    assert (derivative.ratios @ cov @ derivative.ratios.T)[0, 0] == pytest.approx(1e-8, rel=1e-3)
    assert np.sqrt(ratio_covariance(derivative, cov)[0, 0]) > 5e-4


def test_rates_along_axes_that_may_turn_far_have_the_spread_of_drawn_ones() -> None:
    _, derivative = at([1.3, 1.0, 0.8])
    inverse = np.linalg.inv(np.vstack([derivative.ratios, derivative.axes]))
    cov = inverse @ np.diag([1e-4, 1e-4, 1e-3, 1e-3, 0.06]) ** 2 @ inverse.T
    w_P = np.array([[0.5, 0.1, 0.3], [0.0, 0.6, -0.2]])
    change = np.random.default_rng(3).multivariate_normal(np.zeros(5), cov, 20000)
    turned = exp_so3(change @ derivative.axes.T)
    drawn = np.einsum("nji,fj->fni", turned, w_P) - w_P[:, None]
    neglected = nonlinear_turns(derivative, cov, w_P, np.zeros(3, dtype=np.bool_))
    for k, w in enumerate(w_P):
        expected = drawn[k].T @ drawn[k] / len(drawn[k])
        J = hat(w) @ derivative.axes
        first_order = J @ cov @ J.T
        along = w * [1.0, 1.0, 0.0] / np.linalg.norm(w[:2])
        found = along @ (first_order + neglected[k, 3:, 3:]) @ along
        assert found == pytest.approx(along @ expected @ along, rel=0.1)
        assert along @ first_order @ along < 0.3 * found
    # of small turns next to nothing is neglected
    cov = 1e-8 * np.eye(5)
    neglected = nonlinear_turns(derivative, cov, w_P[:1], np.zeros(3, dtype=np.bool_))[0]
    first_order = derivative.axes @ cov @ derivative.axes.T
    assert np.sqrt(np.trace(neglected)) < 1e-2 * np.sqrt(np.trace(first_order))


def test_a_free_turn_leaves_the_worse_tilt_in_both_directions() -> None:
    covariance = np.array([[4.0, 0.5, 0.2], [0.5, 1.0, 0.3], [0.2, 0.3, 9.0]])
    mixed = free_axis_covariance(covariance, np.array([True, False, False]))
    worst = np.linalg.eigvalsh(covariance[1:, 1:])[-1]
    np.testing.assert_allclose(mixed, np.diag([4.0, worst, worst]))
    np.testing.assert_array_equal(free_axis_covariance(covariance, np.array([False] * 3)), covariance)
    np.testing.assert_array_equal(free_axis_covariance(covariance, np.array([True, True, False])), covariance)


def test_a_negative_variance_is_said_and_not_drawn_from() -> None:
    _, derivative = at([1.2, 1.0, 0.7])
    with pytest.raises(np.linalg.LinAlgError, match="covariance of the inertia is not positive definite"):
        ratio_covariance(derivative, np.diag([1e-6, -1e-6, 1e-6, 1e-6, 1e-6]))
