"""Residual kernels against finite differences and against code that does not share theirs."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend.inertia import FORMS, inertia_from_second_moments
from backend.kernels import prior_kernel, stereo_kernel
from backend.step_kernels import dynamics_kernel
from polhode.camera import RectifiedRig
from polhode.lie import Array, exp_so3, log_so3
from polhode.quaternion import wxyz_from_matrix
from polhode.rigid_body import propagate

RIG = RectifiedRig(467.0, 320.0, 240.0, 0.09, 640, 480, 1.5)


def numeric_gradient(function: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Central differences, (..., n)."""
    columns = [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(len(x))]
    return np.stack(columns, axis=-1)


def call_first(kernel: Any, rest: list[Any], x: Array) -> Array:
    """First output of a kernel as a function of x alone."""
    return np.array(float(kernel(x, *rest)[0]))


def symmetric(upper: Array, n: int) -> Array:
    """Upper triangle by columns -> (n, n)."""
    out, at = np.zeros((n, n)), 0
    for j in range(n):
        for i in range(j + 1):
            out[i, j] = out[j, i] = upper[at]
            at += 1
    return out


def stereo_inputs(rng: np.random.Generator) -> tuple[Array, list[Any]]:
    R_RN, R_ref = Rotation.random(2, rng=rng).as_matrix()
    t_R = rng.normal(size=3)
    p_G = rng.normal(size=3) * 0.1
    p_NG = R_RN.T @ (np.array([0.02, -0.03, 0.7]) - t_R)
    x = np.concatenate([p_NG, rng.normal(size=3) * 0.3, p_G])
    uvd = RIG.project(R_RN @ (R_ref @ exp_so3(x[3:6]) @ p_G + p_NG) + t_R) + rng.normal(size=3) * 2
    rig = np.array([RIG.focal_px, RIG.cx_px, RIG.cy_px, RIG.baseline_m, RIG.disparity_offset_px])
    A = (R_RN @ R_ref).ravel(order="F")
    return x, [A, R_RN.ravel(order="F"), t_R, uvd, np.array([1.0, 1.1, 2.0]), rig]


def test_stereo_cost_is_the_robust_norm_of_the_camera_model() -> None:
    rng = np.random.default_rng(0)
    x, rest = stereo_inputs(rng)
    A, R_RN = rest[0].reshape(3, 3, order="F"), rest[1].reshape(3, 3, order="F")
    predicted = RIG.project(A @ exp_so3(x[3:6]) @ x[6:9] + R_RN @ x[:3] + rest[2])
    s = np.sum(((rest[3] - predicted) * rest[4]) ** 2)
    assert float(stereo_kernel(3.0)(x, *rest)[0]) == pytest.approx(4.5 * np.log1p(s / 9.0), rel=1e-12)


def test_stereo_gradient_matches_finite_differences() -> None:
    rng = np.random.default_rng(1)
    kernel = stereo_kernel(3.0)
    for _ in range(5):
        x, rest = stereo_inputs(rng)
        numeric = numeric_gradient(partial(call_first, kernel, rest), x)
        np.testing.assert_allclose(np.asarray(kernel(x, *rest)[1]).ravel(), numeric, rtol=1e-5, atol=1e-4)


def test_stereo_hessian_is_the_second_derivative_where_the_residual_vanishes() -> None:
    rng = np.random.default_rng(2)
    kernel = stereo_kernel(3.0)
    x, rest = stereo_inputs(rng)
    A, R_RN = rest[0].reshape(3, 3, order="F"), rest[1].reshape(3, 3, order="F")
    rest[3] = RIG.project(A @ exp_so3(x[3:6]) @ x[6:9] + R_RN @ x[:3] + rest[2])
    numeric = numeric_gradient(lambda y: np.asarray(kernel(y, *rest)[1]).ravel(), x)
    hessian = symmetric(np.asarray(kernel(x, *rest)[2]).ravel(), 9)
    np.testing.assert_allclose(hessian, numeric, rtol=1e-4, atol=1e-3 * np.abs(numeric).max())


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
