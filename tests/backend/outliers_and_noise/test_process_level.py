"""Stereo terms expanded in the poses: near the solution the condensed problem is the whole one."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.outliers_and_noise.process_level import (
    AGREEING_EVIDENCE,
    FLOOR_PSD,
    INSIGNIFICANT_EVIDENCE,
    CondensedGaussNewton,
    LevelSearch,
    VisionExpansion,
    estimate_process_noise,
    fit_level,
    with_level,
    without_landmarks,
)
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


def test_the_level_found_is_as_likely_as_any_of_its_neighbours(fitted: MotionFit) -> None:
    data, best = fitted.data, estimate_process_noise(fitted)
    levels = np.array([best.data.accel_psd, best.data.torque_psd])
    assert np.all(levels >= FLOOR_PSD)
    assert levels[0] <= data.accel_psd and levels[1] <= data.torque_psd
    # each level is raised towards the stated one while that is not significant
    most = best.minus_log_evidence - 2.0 * INSIGNIFICANT_EVIDENCE - AGREEING_EVIDENCE
    neighbours = [levels * factors for factors in ((10.0, 1.0), (0.1, 1.0), (1.0, 10.0), (1.0, 0.1))]
    for accel_psd, torque_psd in [np.array([1e-8, 1e-8]), *neighbours]:
        other = MotionFit(with_level(data, accel_psd, torque_psd), best.iterate)
        assert fit_level(other, 10).minus_log_evidence > most
