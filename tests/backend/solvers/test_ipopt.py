"""The nonlinear program and Gauss-Newton are two writings of one problem."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import (
    LOOSE_GAUGE,
    TIGHT_GAUGE,
    MotionFit,
    linearization_point,
)
from polhode.backend.solvers.solve import refine
from polhode.config.backend_settings import Backend
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.backend.motions import BOX, at_truth

SCENE = SyntheticScene(frames=6, landmarks=60, detection=0.6, outliers=0.05, J_G=BOX)
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


def start(form: str, scene: SyntheticScene) -> MotionFit:
    """Off the truth by a centimetre and a degree, so that every term pulls."""
    sequence, rng = generate(scene, 0), np.random.default_rng(1)
    truth = at_truth(sequence, Backend.model_validate({"inertia": form}))
    data, at, n = truth.data, truth.iterate, scene.frames
    # with pushes not far from the truth: a short sequence of pushes has many minima
    second = np.diag([0.3, 0.6, 0.9] if scene.pushes else [0.8, 1.0, 1.3])
    xi, R_inertia = data.form.coordinates(second)
    p_NG, w_G = at.p_NG + 0.01 * rng.normal(size=(n, 3)), at.w_G + 0.02 * rng.normal(size=(n, 3))
    p_G = at.p_G + 0.01 * rng.normal(size=at.p_G.shape)
    camera = 1e-3 * rng.normal(size=(n, 6)) if data.camera_is_noisy else None
    at = replace(at, p_NG=p_NG, w_G=w_G, xi=xi, R_inertia=R_inertia, p_G=p_G, camera=camera)
    if scene.pushes:
        scale = np.log(np.cbrt(np.linalg.det(second)))
        unknowns = np.array([scale + 0.1, 0.02, -0.01, 0.03, 0.001, 0.0, -0.001, 1.4, 0.001, -0.002, 0.0])
        at = replace(at, wrench=unknowns, R_torque=sequence.truth.R_GP)
    return MotionFit(data, at)


@pytest.mark.parametrize(("form", "scene"), CASES, ids=NAMES)
def test_both_solvers_see_the_same_cost_whose_gradient_matches_finite_differences(
    form: str, scene: SyntheticScene
) -> None:
    fit = start(form, scene)
    solver, fixed, x = GaussNewton(fit.data), fit.linearized(), fit.iterate.vector()
    # no iteration: the program returns the cost at the start
    solution = MotionProgram(fit.data).solve(fixed, x, 0)
    assert solution.cost == pytest.approx(solver.cost(fixed, x), rel=1e-12)
    assert not solution.converged
    system = solver.normal_equations(fixed, x)
    gradient = np.concatenate([system.g, system.h.ravel()])
    rng, step = np.random.default_rng(2), 1e-6
    for _ in range(12):
        along = rng.normal(size=len(x))
        slope = (solver.cost(fixed, x + step * along) - solver.cost(fixed, x - step * along)) / (2.0 * step)
        assert gradient @ along == pytest.approx(slope, rel=1e-5, abs=1e-4 * np.abs(gradient).max())


@pytest.mark.parametrize(("form", "scene"), [CASES[0], *CASES[2:]], ids=[NAMES[0], *NAMES[2:]])
def test_both_solvers_end_in_the_same_point(form: str, scene: SyntheticScene) -> None:
    fit = start(form, scene)
    # the torque's axes make a curved valley, along which a loose G may take either solver elsewhere
    fixed, x = fit.linearized(TIGHT_GAUGE if scene.pushes else LOOSE_GAUGE), fit.iterate.vector()
    a, b = GaussNewton(fit.data).solve(fixed, x, 100), MotionProgram(fit.data).solve(fixed, x, 100)
    assert a.converged and b.converged
    assert a.cost == pytest.approx(b.cost, rel=1e-7)


@pytest.mark.parametrize("solver", [GaussNewton, MotionProgram])
@pytest.mark.parametrize(
    ("limits", "words"), [((1, np.inf), "max_iterations"), ((50, 1e-9), "max_seconds")], ids=["count", "time"]
)
def test_a_solver_that_meets_a_limit_says_which_and_hands_back_the_best(
    solver: type[GaussNewton | MotionProgram], limits: tuple[int, float], words: str
) -> None:
    fit = start("second_moments", SCENE)
    at, solution, iterations = refine(solver(fit.data), fit.iterate, *limits)
    assert not solution.converged and words in solution.message and iterations <= 1
    before, after = (linearization_point(fit.data, each, TIGHT_GAUGE) for each in (fit.iterate, at))
    # not worse than where it began
    reference = GaussNewton(fit.data)
    assert reference.cost(after, at.vector()) <= reference.cost(before, fit.iterate.vector())
