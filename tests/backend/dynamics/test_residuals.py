"""The residual of the dynamics: finite differences, its twin in CasADi, and an integrated motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polhode.backend.dynamics.kernels import StepLayout, dynamics_kernel
from polhode.backend.dynamics.residuals import (
    FrameStates,
    Steps,
    add_steps,
    dynamics_jacobians,
    dynamics_residuals,
)
from polhode.backend.problem.inertia import FORMS, inertia_derivative, inertia_from_second_moments
from polhode.geometry.lie import Array, exp_so3, log_so3, wxyz_from_matrix
from polhode.geometry.rigid_body import propagate

W_T = np.array([[[1.3, 0.0], [-0.4, 0.9]]])
W_R = np.asarray(np.linalg.cholesky(np.eye(6) + 0.1 * np.ones((6, 6))), dtype=np.float64)[None]


class ResidualCase:
    """Two states of ``size`` numbers, constants, a reference attitude each, and the camera's position."""

    def __init__(self, form: str, size: int, pushed: bool = False, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.form, self.size = FORMS[form], size
        M = rng.normal(size=(3, 3)) * 0.4
        xi, self.R_ref = self.form.coordinates(np.eye(3) + M @ M.T)
        w = rng.normal(size=3)
        R0 = Rotation.random(rng=rng).as_matrix()
        self.R = np.stack([R0, R0 @ exp_so3(0.5 * w + 0.1 * rng.normal(size=3))])
        states = rng.normal(size=(2, size)) * 0.2
        states[:, 9:12] = w + 0.1 * rng.normal(size=(2, 3))
        self.x = np.concatenate([states.ravel(), 0.01 * rng.normal(size=3), xi + 0.1 * rng.normal(size=5)])
        self.camera_N = rng.normal(size=(2, 3))
        self.steps = Steps(np.array([0.5]), np.array([8]), W_T, W_R)
        self.R_torque: Array | None = None
        if pushed:
            known = rng.normal(size=(1, 2, 3)), rng.normal(size=(1, 8, 2, 3))
            self.steps = replace(self.steps, force_increments=known[0], torque_P=known[1])
            self.R_torque = Rotation.random(rng=rng).as_matrix()
            self.x = np.concatenate([self.x, 0.3 * rng.normal(size=11)])

    def residual(self, x: Array) -> Array:
        states, xi = self._unpack(x)
        J = inertia_from_second_moments(self.form.second_moments(xi, self.R_ref))
        return np.asarray(dynamics_residuals(states, self.steps, J)[0])

    def jacobian(self, x: Array) -> tuple[Array, Array]:
        states, xi = self._unpack(x)
        J = inertia_from_second_moments(self.form.second_moments(xi, self.R_ref))
        dJ = inertia_derivative(self.form, xi, self.R_ref)
        residual, jacobian = dynamics_jacobians(states, self.steps, J, dJ)
        return residual[0], jacobian[0]

    def _unpack(self, x: Array) -> tuple[FrameStates, Array]:
        numbers, constants = x[: 2 * self.size].reshape(2, self.size), x[2 * self.size :]
        R_NG = self.R @ exp_so3(numbers[:, 3:6])
        wrench = None if self.R_torque is None else constants[8:]
        states = FrameStates(numbers, R_NG, self.camera_N, constants[:3], wrench, self.R_torque)
        return states, constants[3:8]


def symmetric(upper: Array, n: int) -> Array:
    """Upper triangle by columns -> (n, n)."""
    out, (columns, rows) = np.zeros((n, n)), np.tril_indices(n)
    out[rows, columns] = out[columns, rows] = upper
    return out


@pytest.mark.parametrize(("size", "pushed"), [(12, False), (18, False), (12, True), (18, True)])
@pytest.mark.parametrize("form", FORMS)
def test_jacobian_is_that_of_finite_differences_and_of_the_nonlinear_program(
    form: str, size: int, pushed: bool
) -> None:
    case, step = ResidualCase(form, size, pushed), 1e-6
    residual, jacobian = case.jacobian(case.x)
    np.testing.assert_allclose(residual, case.residual(case.x), rtol=1e-12)
    columns = [(case.residual(case.x + step * e) - case.residual(case.x - step * e)) / (2.0 * step)
               for e in np.eye(len(case.x))]  # fmt: skip
    np.testing.assert_allclose(jacobian, np.stack(columns, axis=1), rtol=1e-6, atol=2e-7)
    q01 = wxyz_from_matrix(case.R[0].T @ case.R[1])
    whiten = [W_T[0, 0, 0], W_T[0, 1, 0], W_T[0, 1, 1], *W_R[0].ravel(order="F")]
    by_columns = [M.ravel(order="F") for M in (*case.R, case.R_ref)]
    parts, torque = [*by_columns, q01, case.steps.dt_s, whiten], []
    parts += list(case.camera_N) if size > 12 else []
    if case.R_torque is not None:
        known = case.steps.force_increments, case.steps.torque_P
        assert known[0] is not None and known[1] is not None
        parts += [case.R_torque.ravel(order="F"), known[0].ravel()]
        torque = [known[1].reshape(8, 6).T]
    arguments, layout = [case.x, np.concatenate(parts), *torque], StepLayout(size, pushed)
    expected = [np.asarray(out) for out in dynamics_kernel(case.form, 8, "jacobian", layout)(*arguments)]
    np.testing.assert_allclose(residual, expected[0].ravel(), atol=1e-12)
    np.testing.assert_allclose(jacobian, expected[1], atol=1e-11)
    outputs = dynamics_kernel(case.form, 8, "quadratic", layout)(*arguments)
    cost, gradient, hessian = (np.asarray(out).ravel() for out in outputs)
    assert cost[0] == pytest.approx(0.5 * np.sum(residual**2))
    np.testing.assert_allclose(gradient, jacobian.T @ residual, atol=1e-9)
    np.testing.assert_allclose(symmetric(hessian, len(case.x)), jacobian.T @ jacobian, atol=1e-9)


def test_the_residual_vanishes_on_the_integrated_rigid_body() -> None:
    J, com = np.diag([0.5, 1.0, 0.8]), np.array([0.01, -0.02, 0.005])
    R0, w0 = Rotation.random(rng=np.random.default_rng(5)).as_matrix(), np.array([0.4, 1.0, -0.3])
    r, v, R, w = propagate([0.0, 0.5], [0.1, 0.2, 0.6], [0.01, 0.0, -0.02], R0, w0, J)
    x = np.hstack([r - R @ com, np.zeros((2, 3)), v, w])
    steps = Steps(np.array([0.5]), np.array([8]), np.eye(2)[None], np.eye(6)[None])
    states = FrameStates(x, R, np.zeros((2, 3)), com)
    assert np.abs(dynamics_residuals(states, steps, J)).max() < 1e-7
    assert np.linalg.norm(log_so3(R[0].T @ R[1])) > 0.3


def test_steps_add_up_in_the_dense_system() -> None:
    rng = np.random.default_rng(1)
    residual, jacobian = rng.normal(size=(2, 12)), rng.normal(size=(2, 12, 32))
    H, g = np.zeros((44, 44)), np.zeros(44)
    add_steps(H, g, residual, jacobian, 12)
    whole = np.zeros((24, 44))
    for k in range(2):
        whole[12 * k : 12 * k + 12, 12 * k : 12 * k + 24] = jacobian[k, :, :24]
        whole[12 * k : 12 * k + 12, 36:] = jacobian[k, :, 24:]
    np.testing.assert_allclose(H, whole.T @ whole, atol=1e-12)
    np.testing.assert_allclose(g, whole.T @ residual.ravel(), atol=1e-12)
