"""Residual kernels against finite differences and against code that does not share theirs."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polhode.backend.dynamics.kernels import dynamics_kernel, prior_kernel
from polhode.backend.problem.inertia import FORMS, inertia_from_second_moments
from polhode.geometry.lie import Array, exp_so3, log_so3, wxyz_from_matrix
from polhode.geometry.rigid_body import propagate


def numeric_gradient(function: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Central differences, (..., n)."""
    columns = [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(len(x))]
    return np.stack(columns, axis=-1)


def symmetric(upper: Array, n: int) -> Array:
    """Upper triangle by columns -> (n, n)."""
    out, at = np.zeros((n, n)), 0
    for j in range(n):
        for i in range(j + 1):
            out[i, j] = out[j, i] = upper[at]
            at += 1
    return out


def dynamics_inputs(form_name: str, rng: np.random.Generator) -> tuple[Array, Array]:
    form = FORMS[form_name]
    M = rng.normal(size=(3, 3)) * 0.4
    xi, R_ref = form.coordinates(np.eye(3) + M @ M.T)
    R0 = Rotation.random(rng=rng).as_matrix()
    w = rng.normal(size=3)
    R1 = R0 @ exp_so3(w * 0.5 + rng.normal(size=3) * 0.1)
    states = [rng.normal(size=3), rng.normal(size=3) * 0.2, rng.normal(size=3), w]
    after = [rng.normal(size=3), rng.normal(size=3) * 0.2, rng.normal(size=3), w + rng.normal(size=3) * 0.1]
    x = np.concatenate([*states, *after, rng.normal(size=3) * 0.01, xi + rng.normal(size=5) * 0.1])
    W_r = np.linalg.cholesky(np.eye(6) + 0.1 * np.ones((6, 6)))
    rotations = [R.ravel(order="F") for R in (R0, R1, R_ref)]
    q01 = wxyz_from_matrix(R0.T @ R1)
    return x, np.concatenate([*rotations, q01, [0.5, 1.3, -0.4, 0.9], W_r.ravel(order="F")])


@pytest.mark.parametrize("form", ["second_moments", "ratios_axes"])
def test_dynamics_jacobian_and_gradient_match_finite_differences(form: str) -> None:
    x, p = dynamics_inputs(form, np.random.default_rng(3))
    jacobian_kernel = dynamics_kernel(FORMS[form], 4, "jacobian")
    numeric = numeric_gradient(lambda y: np.asarray(jacobian_kernel(y, p)[0]).ravel(), x)
    residual, jacobian = (np.asarray(out) for out in jacobian_kernel(x, p))
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-6, atol=1e-7)
    cost, gradient, hessian = (np.asarray(out).ravel() for out in dynamics_kernel(FORMS[form], 4)(x, p))
    assert cost[0] == pytest.approx(0.5 * np.sum(residual**2))
    np.testing.assert_allclose(gradient, (jacobian.T @ residual).ravel(), atol=1e-9)
    np.testing.assert_allclose(symmetric(hessian, 32), jacobian.T @ jacobian, atol=1e-9)


@pytest.mark.parametrize("form", ["second_moments", "ratios_axes"])
def test_prior_jacobian_matches_finite_differences(form: str) -> None:
    rng = np.random.default_rng(4)
    xi, R_ref = FORMS[form].coordinates(np.diag([2.0, 1.0, 0.6]))
    x = np.concatenate([rng.normal(size=3), xi + 0.1])
    p = np.concatenate([rng.normal(size=3), [0.1], R_ref.ravel(order="F")])
    kernel = prior_kernel(FORMS[form], "jacobian")
    numeric = numeric_gradient(lambda y: np.asarray(kernel(y, p)[0]).ravel(), x)
    np.testing.assert_allclose(np.asarray(kernel(x, p)[1]), numeric, rtol=1e-6, atol=1e-7)


def test_dynamics_residual_vanishes_on_the_integrated_rigid_body() -> None:
    rng = np.random.default_rng(5)
    form = FORMS["second_moments"]
    second = np.diag([1.8, 1.0, 0.5])
    xi, R_ref = form.coordinates(second)
    J = inertia_from_second_moments(form.second_moments(xi, R_ref))
    com, R0, w0 = (
        np.array([0.01, -0.02, 0.005]),
        Rotation.random(rng=rng).as_matrix(),
        np.array([0.4, 1.0, -0.3]),
    )
    r, v, R, w = propagate([0.0, 0.5], [0.1, 0.2, 0.6], [0.01, 0.0, -0.02], R0, w0, J)
    before = np.concatenate([r[0] - R[0] @ com, np.zeros(3), v[0], w[0]])
    offset = np.array([0.2, -0.1, 0.3])
    after = np.concatenate([r[1] - R[1] @ com, offset, v[1], w[1]])
    R1_ref = R[1] @ exp_so3(offset).T
    rotations = [M.ravel(order="F") for M in (R[0], R1_ref, R_ref)]
    whiten = np.concatenate([[1.0, 0.0, 1.0], np.eye(6).ravel()])
    p = np.concatenate([*rotations, wxyz_from_matrix(R[0].T @ R1_ref), [0.5], whiten])
    residual = np.asarray(
        dynamics_kernel(form, 8, "jacobian")(np.concatenate([before, after, com, xi]), p)[0]
    )
    assert np.abs(residual).max() < 1e-7
    assert np.linalg.norm(log_so3(R[0].T @ R[1])) > 0.3
