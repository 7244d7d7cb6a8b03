"""A frame finds its pose on the map: by the prediction, or without it, among wrong observations."""

import numpy as np
import pytest

from polhode.backend.window.add_frame import KnownLandmarks, locate
from polhode.geometry.lie import Array, Bools, exp_so3, log_so3, make_pose, transform_points
from polhode.simulation.monte_carlo import RIG

RNG = np.random.default_rng(3)
X_RG = make_pose(exp_so3([0.3, -0.8, 0.2]), [0.02, -0.01, 0.6])


def known(n: int, outliers: float) -> tuple[KnownLandmarks, Bools]:
    p_G = RNG.normal(0.0, 0.06, (n, 3))
    wrong = RNG.random(n) < outliers
    uvd = RIG.project(transform_points(X_RG, p_G)) + RNG.normal(size=(n, 3))
    uvd[wrong] += RNG.uniform(10.0, 30.0, (int(wrong.sum()), 3))
    covariance = np.tile(1e-6 * np.eye(3), (n, 1, 1))
    return KnownLandmarks(uvd, np.ones((n, 3)), p_G, covariance), wrong


def turned(angle_rad: float) -> Array:
    return X_RG @ make_pose(exp_so3([0.0, angle_rad, 0.0]), np.zeros(3))


@pytest.mark.parametrize(("outliers", "guess"), [(0.0, turned(0.001)), (0.3, turned(0.004))])
def test_a_good_prediction_is_kept_and_wrong_observations_are_told(outliers: float, guess: Array) -> None:
    observations, wrong = known(100, outliers)
    found = locate(RIG, observations, guess, 0)
    assert found.by == "prediction"
    assert np.mean(found.agree == ~wrong) > 0.95


@pytest.mark.parametrize("guess", [None, turned(1.0)])
def test_without_a_good_prediction_the_map_tells(guess: Array | None) -> None:
    observations, wrong = known(100, 0.3)
    found = locate(RIG, observations, guess, 0)
    assert found.by == "map"
    assert np.linalg.norm(log_so3(found.X_RG[:3, :3].T @ X_RG[:3, :3])) < 0.02
    assert np.linalg.norm(found.X_RG[:3, 3] - X_RG[:3, 3]) < 0.005
    assert np.mean(found.agree == ~wrong) > 0.95


def test_contradictions_and_strangers_locate_nothing() -> None:
    observations, _ = known(60, 1.0)
    assert locate(RIG, observations, None, 0).by == "nothing"
    few, _ = known(3, 0.0)
    assert locate(RIG, few, None, 0).by == "nothing"
