"""The order in which steps are made shorter, and how that is taken back; equations that no damping helps."""

from dataclasses import replace

import pytest
from scipy.linalg import LinAlgError

from polhode.backend.solvers.gauss_newton import Damping, GaussNewton, NormalEquations
from polhode.backend.solvers.linearization_point import LinearizationPoint, MotionFit
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.backend.motions import cold_start

SCENE = SyntheticScene(frames=16, landmarks=120, detection=0.5, w_G=(0.3, 0.5, 0.35))


@pytest.fixture(scope="module")
def started() -> MotionFit:
    """A problem, and where it begins."""
    return cold_start(generate(SCENE, seed=3), Backend())


class WithKernelCurvature(GaussNewton):
    """The curvature of the kernel makes an element of the diagonal negative, as far from a solution."""

    def normal_equations(
        self, fixed: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        system = super().normal_equations(fixed, x, weight, prior)
        if weight is None:
            H = system.H.copy()
            H[0, 0] = -abs(H[0, 0])
            return replace(system, H=H)
        return system


def test_where_no_damping_helps_a_step_ends_with_an_error(started: MotionFit) -> None:
    data, fixed, x = started.data, started.linearized(), started.iterate.vector()
    solver = GaussNewton(data)
    system = solver.normal_equations(fixed, x)
    system.H[0, 0] = -1.0
    with pytest.raises(LinAlgError):
        solver.step(system, Damping())


def test_where_the_curvature_of_the_kernel_does_harm_the_solver_goes_on_without_it(
    started: MotionFit,
) -> None:
    data, fixed, x = started.data, started.linearized(), started.iterate.vector()
    usual = GaussNewton(data).solve(fixed, x, 20)
    found = WithKernelCurvature(data).solve(fixed, x, 20)
    assert found.cost == pytest.approx(usual.cost, rel=1e-6)


def test_both_ways_grow_apart_and_end() -> None:
    start, before = Damping(), Damping()
    for times in range(1, 3):
        firm, stiff = start.more(times)
        # one lengthens nothing but the constants' share, the other damps all
        assert firm.of_constants > before.of_constants and firm.of_all == start.of_all
        assert stiff.of_all > before.of_all and stiff.of_constants == 0.0
        before = Damping(stiff.of_all, firm.of_constants)
    assert start.more(30) == []


def test_an_accepted_step_takes_damping_back_to_nothing() -> None:
    damping = Damping(of_all=1e-3, of_constants=10.0)
    for _ in range(8):
        damping = damping.less()
    assert damping == Damping()
