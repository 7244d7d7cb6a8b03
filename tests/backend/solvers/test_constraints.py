"""Constraints of the nonlinear program: derivatives against finite differences, and cases that are active."""

from dataclasses import replace
from functools import cache
from typing import cast

import numpy as np
import pytest
from pydantic import ValidationError

from polhode.backend.solvers.constraints import (
    Constraints,
    centre_of_mass_in_hull,
    constraints_of,
    equal_moments,
    inertia_of_hull,
    known_mass,
    landmarks_in_front,
    second_moment_limits,
)
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import TIGHT_GAUGE, MotionFit, linearization_point
from polhode.backend.solvers.solve import refine, solve
from polhode.config.backend_settings import Backend, Bounds
from polhode.geometry.lie import Array
from polhode.records.estimate import MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.backend.motions import BOX, estimated
from tests.backend.solvers.test_ipopt import CASES, NAMES, start

PLATE = np.random.default_rng(7).uniform(-1.0, 1.0, size=(400, 3)) * [0.3, 0.2, 0.01]
"""Landmarks on and in a thin plate [m]"""
LIMITS = cast(tuple[Array, Array, Array], second_moment_limits(PLATE, 1.1, 8.0))
NORMALS = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.0, 0.0, -1.0]])


@pytest.mark.parametrize(("form", "scene"), CASES, ids=NAMES)
def test_derivatives_are_those_of_finite_differences(form: str, scene: SyntheticScene) -> None:
    fit = start(form, scene)
    data, at, fixed = fit.data, fit.iterate, fit.linearized()
    x = at.vector() + 0.01 * np.random.default_rng(2).normal(size=len(at.vector()))
    parts = [
        centre_of_mass_in_hull(at, NORMALS, np.array([0.1, 0.2, 0.3])),
        landmarks_in_front(data, at, 0.1),
        equal_moments(data.form, at, "largest"),
        equal_moments(data.form, at, "smallest"),
        inertia_of_hull(data.form, at, *LIMITS),
    ]
    if at.wrench is not None:
        parts.append(known_mass(at, 4.5))
    constraints = Constraints(tuple(parts))
    rows, columns = constraints.cells()
    slopes = np.zeros((len(constraints.limits[0]), len(x)))
    np.add.at(slopes, (rows, columns), constraints.derivatives(fixed, x))
    assert len(np.unique(rows * len(x) + columns)) == len(rows)
    rng = np.random.default_rng(3)
    for _ in range(8):
        step = 1e-6 * rng.normal(size=len(x))
        found = (constraints.values(fixed, x + step) - constraints.values(fixed, x - step)) / 2.0
        np.testing.assert_allclose(slopes @ step, found, rtol=1e-6, atol=1e-12)


def test_nothing_is_constrained_by_default_and_settings_are_checked() -> None:
    fit = start(*CASES[0])
    assert not constraints_of(fit, Backend()) and not MotionProgram(fit.data).constraints
    # without known forces there is no mass to constrain
    assert not constraints_of(fit, Backend(mass_kg=5.0, bounds=Bounds(known_mass=True)))
    with pytest.raises(ValidationError, match="com_in: box needs com_box_G"):
        Bounds(com_in="box")
    with pytest.raises(ValidationError, match="least coordinates first"):
        Bounds(com_in="box", com_box_G=((0.1, 0.0, 0.0), (0.0, 1.0, 1.0)))


SPIN = SyntheticScene(
    frames=20, landmarks=150, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.1, J_G=BOX,
    w_G=(0.0, 0.0, 0.8), accel_psd=1e-8, torque_psd=1e-8,
)  # fmt: skip


def solved(bounds: Bounds, scene: SyntheticScene = SPIN) -> MotionEstimate:
    config = Backend(process_noise="given", accel_psd=1e-8, torque_psd=1e-8, bounds=bounds)
    return estimated(generate(scene, 0), config)


@cache
def free() -> MotionEstimate:
    return solved(Bounds())


def test_the_centre_of_mass_of_a_spin_stays_inside_a_box() -> None:
    assert free().solver.constraints == {}
    low, high = free().mass.com_G - 0.1, free().mass.com_G + 0.1
    # a box that leaves the estimate out along the axis of rotation
    low[int(np.argmax(np.abs(free().mass.R_GP @ free().w_P[0])))] += 0.11
    box = (tuple(low.tolist()), tuple(high.tolist()))
    held = solved(Bounds.model_validate({"com_in": "box", "com_box_G": box}))
    assert held.solver.constraints == {"centre of mass in hull": True} and held.solver.converged
    assert np.all(held.mass.com_G >= low - 1e-5) and np.all(held.mass.com_G <= high + 1e-5)
    # the data do not care: the same cost, and the same attitudes of the body
    assert held.solver.cost == pytest.approx(free().solver.cost, rel=1e-3)
    np.testing.assert_allclose(held.X_NG[:, :3, :3], free().X_NG[:, :3, :3], atol=1e-3)


def test_constraints_that_hold_anyway_change_nothing() -> None:
    bounds = Bounds(com_in="landmarks", hull_growth=5.0, least_depth_m=0.05, inertia_in="landmarks")
    held = solved(bounds)
    names = "centre of mass in hull", "landmarks in front of the cameras", "inertia of a body in hull"
    assert held.solver.constraints == dict.fromkeys(names, False)
    np.testing.assert_array_equal(held.r_N, free().r_N)


@pytest.mark.parametrize(("which", "J"), [("largest", (1.3, 1.28, 0.8)), ("smallest", (1.3, 0.82, 0.8))])
def test_equal_moments_are_equal(which: str, J: tuple[float, float, float]) -> None:
    scene = replace(SPIN, J_G=np.diag(J), w_G=(0.4, 0.1, 0.6))
    held = solved(Bounds.model_validate({"equal_moments": which}), scene)
    assert held.solver.constraints == {f"{which} moments equal": True}
    equal, other = (held.mass.k1, held.mass.k2) if which == "largest" else (held.mass.k2, held.mass.k1)
    expected = np.log(1.29 / 0.8 if which == "largest" else 1.3 / 0.81)
    assert equal < 1e-4 and other == pytest.approx(expected, abs=0.03)


@cache
def optimum() -> MotionFit:
    fit = start(*CASES[0])
    return MotionFit(fit.data, refine(GaussNewton(fit.data, line_search=True), fit.iterate, 50)[0])


def test_no_landmark_comes_closer_than_the_least_depth() -> None:
    data, iterate = optimum().data, optimum().iterate
    every = landmarks_in_front(data, iterate, 0.0)
    depth = every.evaluate(optimum().linearized(TIGHT_GAUGE), iterate.vector())[0]
    np.testing.assert_allclose(depth.min(), 0.5, atol=0.1)
    least_m = float(depth.min()) + 1e-3
    held = Constraints((landmarks_in_front(data, iterate, least_m),))
    at, solution, _ = refine(MotionProgram(data, held), iterate, 100)
    assert solution.converged
    after = every.evaluate(linearization_point(data, at, TIGHT_GAUGE), at.vector())[0]
    assert after.min() == pytest.approx(least_m, abs=1e-6)


def along(second: Array, directions: Array) -> Array:
    return np.asarray(np.einsum("di,ij,dj->d", directions, second, directions))


def test_masses_in_a_hull_are_within_its_limits_and_others_are_not() -> None:
    directions, least, most = LIMITS
    assert len(directions) == 13 and np.all(least < most)
    rng, part = np.random.default_rng(8), len(PLATE) // 8
    for n in range(20):
        # a part of the points, anywhere or together, is eight times as dense as the mean, the rest is empty
        distance = np.linalg.norm(PLATE - PLATE[rng.integers(len(PLATE))], axis=1)
        chosen = PLATE[(rng.permutation(len(PLATE)) if n % 2 else np.argsort(distance))[:part]]
        p = chosen - chosen.mean(axis=0)
        a = along(p.T @ p / len(p), directions)
        assert np.all(a >= least) and np.all(a <= most)
    ball = along(np.eye(3), directions)
    i, j = np.argmax(least / ball), np.argmin(most / ball)
    assert least[i] * ball[j] > most[j] * ball[i]
    assert second_moment_limits(PLATE * [1.0, 1.0, 0.0], 1.1, 8.0) is None


def test_an_inertia_that_the_hull_excludes_is_drawn_to_the_limit() -> None:
    data, iterate = optimum().data, optimum().iterate
    a = along(iterate.second_moments(data.form), np.eye(3))
    # the largest second moment along x over that along y, smaller than what the data say
    largest = 0.7 * a[0] / a[1]
    least, most = np.array([1.0, 1.0, 1e-6]), np.array([largest, 1.0, 1e6])
    held = Constraints((inertia_of_hull(data.form, iterate, np.eye(3), least, most),))
    fixed = optimum().linearized(TIGHT_GAUGE)
    assert held.reached(fixed, iterate.vector())["inertia of a body in hull"]
    assert not held.hold(fixed, iterate.vector())
    at, solution, _ = refine(MotionProgram(data, held), iterate, 100)
    assert solution.converged
    after = along(at.second_moments(data.form), np.eye(3))
    # IPOPT's barrier keeps off the limit by its tolerance
    assert 0.9999 * largest < after[0] / after[1] <= largest


def test_a_known_mass_is_kept() -> None:
    config = Backend(inertia="ratios_axes", mass_kg=5.0, bounds=Bounds(known_mass=True))
    ended = solve(start(*CASES[4]), config)
    assert ended.constraints == {"known mass": True}
    assert ended.iterate.wrench is not None
    assert np.exp(ended.iterate.wrench[7]) == pytest.approx(5.0, rel=1e-6)
