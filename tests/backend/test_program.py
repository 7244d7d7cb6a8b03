"""The nonlinear program and Gauss-Newton are two writings of one problem."""

from dataclasses import replace

import numpy as np
import pytest

from backend.gauss_newton import GaussNewton
from backend.inertia import FORMS
from backend.iterate import Iterate
from backend.kernels import bend_sx
from backend.problem import hold, motion_data
from backend.program import MotionProgram
from polhode.config.backend import Backend
from simulation.measurements import SyntheticScene, generate

SCENE = SyntheticScene(frames=6, landmarks=60, detection=0.6, outliers=0.05, J_G=np.diag([1.5, 1.2, 0.9]))


CASES = [("second_moments", 0.0), ("ratios_axes", 0.0), ("second_moments", 1e-3)]


def start(form: str, sigma_camera: float = 0.0) -> tuple[GaussNewton, MotionProgram, Iterate]:
    """Off the truth by a centimetre and a degree, so that every term pulls."""
    scene = replace(SCENE, sigma_camera_p_m=sigma_camera, sigma_camera_theta_rad=sigma_camera)
    sequence, rng = generate(scene, 0), np.random.default_rng(1)
    data = motion_data(sequence.tracks, Backend.model_validate({"inertia": form}))
    X_NG, truth = sequence.X_NG, sequence.truth
    w_G = np.einsum("fba,fbc,fc->fa", X_NG[:, :3, :3], truth.R_NP, truth.w_P)
    xi, R_inertia = FORMS[form].coordinates(np.diag([0.8, 1.0, 1.3]))
    iterate = Iterate(
        X_NG[:, :3, 3] + 0.01 * rng.normal(size=(6, 3)), X_NG[:, :3, :3], truth.v_N,
        w_G + 0.02 * rng.normal(size=(6, 3)), truth.com_G, xi, R_inertia,
        sequence.p_G + 0.01 * rng.normal(size=sequence.p_G.shape),
        1e-3 * rng.normal(size=(6, 6)) if data.camera_is_noisy else None,
    )  # fmt: skip
    return GaussNewton(data), MotionProgram(data), iterate


@pytest.mark.parametrize(("form", "sigma_camera"), CASES)
def test_both_solvers_see_the_same_cost(form: str, sigma_camera: float) -> None:
    solver, program, iterate = start(form, sigma_camera)
    held = hold(solver.data, iterate)
    # no iteration: the program returns the cost at the start
    solution = program.solve(held, iterate.vector(), 0)
    assert solution.cost == pytest.approx(solver.cost(held, iterate.vector()), rel=1e-12)
    assert not solution.converged


@pytest.mark.parametrize(("form", "sigma_camera"), CASES)
def test_gradient_of_the_normal_equations_matches_finite_differences(form: str, sigma_camera: float) -> None:
    solver, _, iterate = start(form, sigma_camera)
    held, x = hold(solver.data, iterate), iterate.vector()
    system = solver.normal_equations(held, x)
    gradient = np.concatenate([system.g, system.h.ravel()])
    rng, step = np.random.default_rng(2), 1e-6
    for _ in range(12):
        along = rng.normal(size=len(x))
        slope = (solver.cost(held, x + step * along) - solver.cost(held, x - step * along)) / (2.0 * step)
        assert gradient @ along == pytest.approx(slope, rel=1e-5, abs=1e-4 * np.abs(gradient).max())


@pytest.mark.parametrize("sigma_camera", [0.0, 1e-3])
def test_both_solvers_end_in_the_same_point(sigma_camera: float) -> None:
    solver, program, iterate = start("second_moments", sigma_camera)
    held = hold(solver.data, iterate)
    a, b = solver.solve(held, iterate.vector(), 100), program.solve(held, iterate.vector(), 100)
    assert a.converged and b.converged
    assert a.cost == pytest.approx(b.cost, rel=1e-7)


def test_the_bent_jacobian_is_the_second_derivative_of_the_kernel_near_zero() -> None:
    c, s = 3.0, np.array([0.0, 0.1, 1.0, 2.0])
    bend = bend_sx(s, c)
    weight = 1.0 / (1.0 + s / c**2)
    # along the residual: rho''(r) of 0.5 c^2 ln(1 + r^2 / c^2)
    exact = (1.0 - s / c**2) / (1.0 + s / c**2) ** 2
    np.testing.assert_allclose(weight * (1.0 - bend * s) ** 2, exact, atol=1e-9)
    # and far from zero it stays positive
    assert np.all((1.0 - bend_sx(np.array([50.0, 1e6]), c) * np.array([50.0, 1e6])) ** 2 > 0.3)
