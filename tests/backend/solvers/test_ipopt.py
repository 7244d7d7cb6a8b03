"""The nonlinear program and Gauss-Newton are two writings of one problem."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.problem.inertia import FORMS
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import LOOSE_GAUGE, TIGHT_GAUGE, linearization_point
from polhode.backend.solvers.robust_kernel import kernel_curvature
from polhode.backend.solvers.solve import refine
from polhode.config.backend_settings import Backend
from polhode.simulation.monte_carlo import SyntheticScene, generate

SCENE = SyntheticScene(frames=6, landmarks=60, detection=0.6, outliers=0.05, J_G=np.diag([1.5, 1.2, 0.9]))


PUSHES = ((1.2, 2.9, (0.1, -0.2, 0.3), (0.05, 0.1, -0.08)), (5.5, 1.0, (0.0, 0.1, 0.0), (-0.1, 0.0, 0.1)))
PUSHED = replace(SCENE, frames=16, landmarks=100, outliers=0.0, pushes=PUSHES)
CASES = [
    ("second_moments", SCENE),
    ("ratios_axes", SCENE),
    ("second_moments", replace(SCENE, sigma_camera_p_m=1e-3, sigma_camera_theta_rad=1e-3)),
    ("second_moments", replace(PUSHED, sigma_camera_p_m=1e-3)),
    ("ratios_axes", PUSHED),
]
NAMES = ["plain", "ratios", "noisy camera", "pushed, noisy camera", "pushed, ratios"]


def start(form: str, scene: SyntheticScene) -> tuple[GaussNewton, MotionProgram, Iterate]:
    """Off the truth by a centimetre and a degree, so that every term pulls."""
    sequence, rng = generate(scene, 0), np.random.default_rng(1)
    data = motion_data(sequence.tracks, Backend.model_validate({"inertia": form}))
    X_NG, truth = sequence.X_NG, sequence.truth
    w_G = np.einsum("fba,fbc,fc->fa", X_NG[:, :3, :3], truth.R_NP, truth.w_P)
    xi, R_inertia = FORMS[form].coordinates(np.diag([0.8, 1.0, 1.3]))
    iterate = Iterate(
        X_NG[:, :3, 3] + 0.01 * rng.normal(size=(scene.frames, 3)), X_NG[:, :3, :3], truth.v_N,
        w_G + 0.02 * rng.normal(size=(scene.frames, 3)), truth.com_G, xi, R_inertia,
        sequence.p_G + 0.01 * rng.normal(size=sequence.p_G.shape),
        1e-3 * rng.normal(size=(scene.frames, 6)) if data.camera_is_noisy else None,
    )  # fmt: skip
    if scene.pushes:
        # not far from the truth: a short sequence of pushes has many minima
        second = np.diag([0.3, 0.6, 0.9])
        xi, R_inertia = FORMS[form].coordinates(second)
        scale = np.log(np.cbrt(np.linalg.det(second)))
        unknowns = np.array([scale + 0.1, 0.02, -0.01, 0.03, 0.001, 0.0, -0.001, 1.4, 0.001, -0.002, 0.0])
        iterate = replace(iterate, xi=xi, R_inertia=R_inertia, wrench=unknowns, R_torque=truth.R_GP)
    return GaussNewton(data), MotionProgram(data), iterate


@pytest.mark.parametrize(("form", "scene"), CASES, ids=NAMES)
def test_both_solvers_see_the_same_cost(form: str, scene: SyntheticScene) -> None:
    solver, program, iterate = start(form, scene)
    fixed = linearization_point(solver.data, iterate)
    # no iteration: the program returns the cost at the start
    solution = program.solve(fixed, iterate.vector(), 0)
    assert solution.cost == pytest.approx(solver.cost(fixed, iterate.vector()), rel=1e-12)
    assert not solution.converged


@pytest.mark.parametrize(("form", "scene"), CASES, ids=NAMES)
def test_gradient_of_the_normal_equations_matches_finite_differences(
    form: str, scene: SyntheticScene
) -> None:
    solver, _, iterate = start(form, scene)
    fixed, x = linearization_point(solver.data, iterate), iterate.vector()
    system = solver.normal_equations(fixed, x)
    gradient = np.concatenate([system.g, system.h.ravel()])
    rng, step = np.random.default_rng(2), 1e-6
    for _ in range(12):
        along = rng.normal(size=len(x))
        slope = (solver.cost(fixed, x + step * along) - solver.cost(fixed, x - step * along)) / (2.0 * step)
        assert gradient @ along == pytest.approx(slope, rel=1e-5, abs=1e-4 * np.abs(gradient).max())


@pytest.mark.parametrize(("form", "scene"), [CASES[0], *CASES[2:]], ids=[NAMES[0], *NAMES[2:]])
def test_both_solvers_end_in_the_same_point(form: str, scene: SyntheticScene) -> None:
    solver, program, iterate = start(form, scene)
    # the torque's axes make a curved valley, along which a loose G may take either solver elsewhere
    fixed = linearization_point(solver.data, iterate, TIGHT_GAUGE if scene.pushes else LOOSE_GAUGE)
    a, b = solver.solve(fixed, iterate.vector(), 100), program.solve(fixed, iterate.vector(), 100)
    assert a.converged and b.converged
    assert a.cost == pytest.approx(b.cost, rel=1e-7)


def test_the_bent_jacobian_is_the_second_derivative_of_the_kernel_near_zero() -> None:
    c, s = 3.0, np.array([0.0, 0.1, 1.0, 2.0])
    bend = kernel_curvature(s, c)
    weight = 1.0 / (1.0 + s / c**2)
    # along the residual: rho''(r) of 0.5 c^2 ln(1 + r^2 / c^2)
    exact = (1.0 - s / c**2) / (1.0 + s / c**2) ** 2
    np.testing.assert_allclose(weight * (1.0 - bend * s) ** 2, exact, atol=1e-9)
    # and far from zero it stays positive
    assert np.all((1.0 - kernel_curvature(np.array([50.0, 1e6]), c) * np.array([50.0, 1e6])) ** 2 > 0.3)


@pytest.mark.parametrize("which", [0, 1], ids=["gauss_newton", "ipopt"])
@pytest.mark.parametrize(
    ("limits", "words"), [((1, np.inf), "max_iterations"), ((50, 1e-9), "max_seconds")], ids=["count", "time"]
)
def test_a_solver_that_meets_a_limit_says_which_and_hands_back_the_best(
    which: int, limits: tuple[int, float], words: str
) -> None:
    *solvers, iterate = start("second_moments", SCENE)
    solver = solvers[which]
    assert isinstance(solver, GaussNewton | MotionProgram)
    data = solver.data
    at, solution, iterations = refine(solver, data, iterate, *limits)
    assert not solution.converged and words in solution.message and iterations <= 1
    reference, fixed = GaussNewton(data), linearization_point(data, iterate, TIGHT_GAUGE)
    # not worse than where it began
    assert reference.cost(linearization_point(data, at, TIGHT_GAUGE), at.vector()) <= reference.cost(
        fixed, iterate.vector()
    )
