"""Derivatives of the dynamics as the window scatters them, by finite differences."""

import numpy as np
import pytest

from polhode.backend.problem.inertia import FORMS
from polhode.backend.window.dynamics_factors import (
    NO_FACTORS,
    DisturbanceLevels,
    add_factors,
    factor_jacobians,
    factor_residuals,
    make_factors,
)
from polhode.lie import Array, exp_so3

RNG = np.random.default_rng(1)
DT_S = np.array([0.5, 0.3, 0.7])


def unknowns() -> tuple[Array, Array]:
    """States of four frames that follow each other roughly, and the constants."""
    states = np.zeros((4, 12))
    w_G = np.array([0.3, 0.5, -0.2])
    R_ref = exp_so3(np.outer(np.concatenate([[0.0], np.cumsum(DT_S)]), w_G))
    states[:, :9], states[:, 9:] = RNG.normal(0.0, 0.02, (4, 9)), w_G + RNG.normal(0.0, 0.02, (4, 3))
    return np.concatenate([states.ravel(), [4e-3, -1e-3, 2e-3], RNG.normal(0.0, 0.1, 5)]), R_ref


@pytest.mark.parametrize("name", ["second_moments", "ratios_axes"])
def test_gradient_of_the_steps_cost(name: str) -> None:
    form = FORMS[name]
    x, R_ref = unknowns()
    xi, R_inertia = form.coordinates(np.diag([1.0, 1.4, 2.0]))
    x[-5:] += xi
    factors = make_factors(
        x[:-8].reshape(-1, 12)[:-1, 9:], np.eye(3), np.eye(3), DT_S, DisturbanceLevels(1e-6, 1e-6)
    )
    r, D = factor_jacobians(x, R_ref, factors, form, R_inertia)
    np.testing.assert_allclose(factor_residuals(x, R_ref, factors, form, R_inertia), r)
    H, g = np.zeros((56, 56)), np.zeros(56)
    add_factors(H, g, r, D, 12 * np.arange(3))
    step = 1e-6

    def cost(x: Array) -> float:
        return 0.5 * float(np.sum(factor_residuals(x, R_ref, factors, form, R_inertia) ** 2))

    slope = [(cost(x + step * e) - cost(x - step * e)) / (2 * step) for e in np.eye(56)]
    np.testing.assert_allclose(g, slope, rtol=1e-5, atol=1e-5 * np.abs(g).max())
    assert np.linalg.eigvalsh(H)[0] > -1e-9 * H.max()


def test_links_are_split_and_joined() -> None:
    w_G = np.tile([0.3, 0.5, -0.2], (3, 1))
    factors = make_factors(w_G, np.eye(3), np.eye(3), DT_S, DisturbanceLevels(1e-6, 1e-6))
    again = NO_FACTORS.and_then(factors.part(slice(0, 1))).and_then(factors.part(slice(1, None)))
    assert len(again) == 3
    np.testing.assert_array_equal(again.steps.W_r, factors.steps.W_r)
