"""Stereo terms expanded in the poses: near the solution the condensed problem is the whole one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from polhode.backend.outliers_and_noise.process_level import (
    AGREEING_EVIDENCE,
    CondensedGaussNewton,
    LevelSearch,
    VisionExpansion,
    estimate_process_noise,
    fit_level,
    with_level,
    without_landmarks,
)
from polhode.backend.problem.level_prior import FLOOR_PSD
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.config.backend_settings import Backend
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.backend.motions import best_hypothesis

SCENE = SyntheticScene(
    frames=24, landmarks=120, detection=0.5, w_G=(0.3, 0.5, 0.35), J_G=np.diag([3.0e-2, 2.4e-2, 1.8e-2]),
    accel_psd=1e-8, torque_psd=1e-8,
)  # fmt: skip


@pytest.fixture(scope="module", params=[0.0, 2e-3], ids=["exact camera", "noisy camera"])
def fitted(request: pytest.FixtureRequest) -> MotionFit:
    """A problem and its solution under the stated process noise."""
    sequence = generate(SCENE, seed=3)
    tracks = replace(sequence.tracks, sigma_camera_theta_rad=request.param)
    found = fit_level(best_hypothesis(replace(sequence, tracks=tracks), Backend()), 30)
    return MotionFit(found.data, found.iterate)


def test_gradient_and_information_are_those_of_the_whole_problem(fitted: MotionFit) -> None:
    data, iterate = fitted.data, fitted.iterate
    vision = VisionExpansion.of(fitted)
    condensed, whole = CondensedGaussNewton(data, vision), GaussNewton(data)
    fixed = condensed.linearization_point()
    system = whole.normal_equations(fixed, iterate.vector())
    reduced, slope, _ = whole.reduced(system)
    x = without_landmarks(iterate)
    of_states = condensed.normal_equations(fixed, x)
    # the landmarks' own decrease is in the expansion's value
    assert of_states.cost == pytest.approx(system.cost, rel=1e-6)
    scale = np.sqrt(np.diag(reduced))
    lower = np.tril(np.ones_like(reduced)) > 0.0
    difference = (of_states.H - reduced) / np.outer(scale, scale)
    assert np.abs(difference[lower]).max() < 1e-8
    assert np.abs((of_states.g - slope) / scale).max() < 1e-6


def test_evidence_differs_between_levels_as_that_of_the_whole_problem(fitted: MotionFit) -> None:
    data, search = fitted.data, LevelSearch(fitted)
    levels = [(1e-8, 1e-8), (1e-9, 1e-8), (1e-8, 1e-9), (1e-7, 1e-7)]
    problems = [with_level(data, *level) for level in levels]
    condensed = [search.fit(each, search.start, 10).minus_log_evidence for each in problems]
    whole = [fit_level(MotionFit(each, fitted.iterate), 10).minus_log_evidence for each in problems]
    assert np.allclose(np.diff(condensed), np.diff(whole), atol=AGREEING_EVIDENCE)


def test_the_level_is_the_mean_of_the_posterior_of_the_whole_problem(fitted: MotionFit) -> None:
    found = estimate_process_noise(fitted).data
    prior, at = fitted.data.level_prior, np.arange(-12.0, 1.51, 0.5)
    for axis, psd in enumerate((found.accel_psd, found.torque_psd)):
        levels = np.tile([found.accel_psd, found.torque_psd], (len(at), 1))
        # below the floor the evidence is that of the floor
        levels[:, axis] = np.maximum(prior.stated[axis] * 10.0**at, FLOOR_PSD)
        fits = [fit_level(MotionFit(with_level(found, *each), fitted.iterate), 20) for each in levels]
        cost = np.array([each.minus_log_evidence for each in fits]) + prior.minus_log(at)
        fine = np.linspace(at[0], at[-1], 2001)
        weight = np.exp(cost.min() - CubicSpline(at, cost)(fine))
        mean = np.average(prior.stated[axis] * 10.0**fine, weights=weight)
        spread = np.sqrt(np.cov(fine, aweights=weight))
        # the expansion has the evidence of the problem within AGREEING_EVIDENCE
        assert abs(np.log10(psd / mean)) < 0.25 * spread
        assert found.level_decades[axis] == pytest.approx(float(spread), rel=0.25)
