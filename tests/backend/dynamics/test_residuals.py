"""The residual of the dynamics against finite differences and against its twin in CasADi."""

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
from polhode.geometry.lie import Array, exp_so3, wxyz_from_matrix

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
        residual, jacobian = dynamics_jacobians(
            states, self.steps, J, inertia_derivative(self.form, xi, self.R_ref)
        )
        return residual[0], jacobian[0]

    def _unpack(self, x: Array) -> tuple[FrameStates, Array]:
        numbers, constants = x[: 2 * self.size].reshape(2, self.size), x[2 * self.size :]
        R_NG = self.R @ exp_so3(numbers[:, 3:6])
        wrench = None if self.R_torque is None else constants[8:]
        states = FrameStates(numbers, R_NG, self.camera_N, constants[:3], wrench, self.R_torque)
        return states, constants[3:8]


@pytest.mark.parametrize(("size", "pushed"), [(12, False), (18, False), (12, True)])
@pytest.mark.parametrize("form", FORMS)
def test_jacobian_matches_finite_differences(form: str, size: int, pushed: bool) -> None:
    case, step = ResidualCase(form, size, pushed), 1e-6
    residual, jacobian = case.jacobian(case.x)
    np.testing.assert_allclose(residual, case.residual(case.x), rtol=1e-12)
    columns = [(case.residual(case.x + step * e) - case.residual(case.x - step * e)) / (2.0 * step)
               for e in np.eye(len(case.x))]  # fmt: skip
    np.testing.assert_allclose(jacobian, np.stack(columns, axis=1), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(("size", "pushed"), [(12, False), (18, False), (12, True), (18, True)])
@pytest.mark.parametrize("form", FORMS)
def test_it_is_the_residual_that_the_nonlinear_program_holds(form: str, size: int, pushed: bool) -> None:
    case = ResidualCase(form, size, pushed)
    q01 = wxyz_from_matrix(case.R[0].T @ case.R[1])
    by_columns = [M.ravel(order="F") for M in (*case.R, case.R_ref)]
    whiten = [W_T[0, 0, 0], W_T[0, 1, 0], W_T[0, 1, 1], *W_R[0].ravel(order="F")]
    parts = [*by_columns, q01, case.steps.dt_s, whiten, *(case.camera_N if size > 12 else [])]
    arguments = [case.x]
    if (
        case.R_torque is not None
        and case.steps.force_increments is not None
        and case.steps.torque_P is not None
    ):
        parts += [case.R_torque.ravel(order="F"), case.steps.force_increments.ravel()]
        arguments.append(case.steps.torque_P.reshape(8, 6).T)
    arguments.insert(1, np.concatenate(parts))
    kernel = dynamics_kernel(case.form, 8, "jacobian", StepLayout(size, pushed))
    expected = [np.asarray(out) for out in kernel(*arguments)]
    residual, jacobian = case.jacobian(case.x)
    np.testing.assert_allclose(residual, expected[0].ravel(), atol=1e-12)
    np.testing.assert_allclose(jacobian, expected[1], atol=1e-11)


def test_an_exact_camera_gives_the_same_residual_as_none() -> None:
    noisy, x = ResidualCase("second_moments", 18), ResidualCase("second_moments", 18).x.copy()
    x[12:18] = x[30:36] = 0.0
    plain = ResidualCase("second_moments", 12)
    plain.R, plain.R_ref = noisy.R, noisy.R_ref
    short = np.concatenate([x[:12], x[18:30], x[36:]])
    np.testing.assert_allclose(noisy.residual(x), plain.residual(short), atol=1e-12)


def test_a_common_error_of_the_camera_moves_the_target_as_a_rigid_whole() -> None:
    # the same shift of two stated positions cancels in the dynamics
    case = ResidualCase("second_moments", 18)
    x = case.x.copy()
    x[12:18] = x[30:36] = 0.0
    shifted = x.copy()
    shifted[12:15] = shifted[30:33] = [0.3, -0.2, 0.1]
    np.testing.assert_allclose(case.residual(shifted), case.residual(x), atol=1e-12)


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
