"""What observations share is measured where it is, and nowhere else."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from polhode.backend.outliers_and_noise.correlated_noise import (
    CorrelatedNoise,
    measure_correlation,
    turns_between,
)
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.uncertainty.covariance import observation_jacobians
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, exp_so3
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.backend.motions import BOX, at_truth

SCENE = SyntheticScene(
    frames=30, landmarks=1500, detection=0.7, w_G=(0.3, 0.2, 0.25), J_G=BOX,
    sigma_uv_px=0.3, sigma_d_px=0.2,
)  # fmt: skip


@cache
def exact() -> tuple[MotionData, Array, Array]:
    """Measurements without noise at the truth; derivatives in the landmarks; turns between the frames."""
    fit = at_truth(generate(replace(SCENE, sigma_uv_px=1e-9, sigma_d_px=1e-9), 5))
    fit = fit.with_data(inv_sigma=np.broadcast_to([1 / 0.3, 1 / 0.3, 1 / 0.2], fit.data.uvd_px.shape))
    R_NG = fit.iterate.R_NG
    return fit.data, observation_jacobians(fit)[1], turns_between(R_NG, fit.data.R_RN @ R_NG)


def measured(errors: Array) -> CorrelatedNoise:
    """From the residuals that errors (M, 3) leave when each landmark is fitted to them."""
    data, to_landmark, turn_rad = exact()
    left = errors.copy()
    for first, last in pairwise(data.start):
        J, e = to_landmark[first:last].reshape(-1, 3), errors[first:last].ravel()
        left[first:last] = (e - J @ np.linalg.lstsq(J, e, rcond=None)[0]).reshape(-1, 3)
    found = measure_correlation(data, left, to_landmark, turn_rad)
    assert found is not None
    return found


def test_independent_errors_share_nothing() -> None:
    data = exact()[0]
    found = measured(np.random.default_rng(0).normal(size=data.uvd_px.shape))
    np.testing.assert_allclose(found.independent + found.drifting.sum(axis=1), 1.0, atol=0.1)
    assert found.drifting[:, 1:].sum() < 0.1
    assert (found.shared * np.exp(-3.0 / found.length_px)).max() < 0.05
    np.testing.assert_allclose(found.variance(data).mean(axis=0), 1.0, atol=0.15)


@pytest.mark.parametrize("forgetting_rad", [2.0, 6.0])
def test_a_drift_is_found_with_its_size_and_its_turn(forgetting_rad: float) -> None:
    (data, _, turn_rad), rng = exact(), np.random.default_rng(1)
    errors = rng.normal(size=data.uvd_px.shape)
    for first, last in pairwise(data.start):
        # errors that a landmark keeps over a turn
        k = data.frame[first:last]
        alike = np.exp(-turn_rad[np.ix_(k, k)] / forgetting_rad) + 1e-9 * np.eye(len(k))
        errors[first:last, :2] += 1.5 * np.linalg.cholesky(alike) @ rng.normal(size=(len(k), 2))
    found = measured(errors)
    # a constant error of a landmark is its position: only the change with the turn can be measured
    at = np.array([[0.0, 0.4, 1.0, 1.8]])
    covariance = found.drift_between(at)[0, 0]
    true = 2.25 * np.exp(-at[0] / forgetting_rad)
    np.testing.assert_allclose(covariance[0] - covariance, true[0] - true, atol=0.25)
    assert found.independent[0] + found.drifting[0, 0] == pytest.approx(1.0, abs=0.35)
    assert found.independent[1] + found.drifting[1].sum() == pytest.approx(1.0, abs=0.2)


def test_what_neighbours_share_is_found_and_counted_as_a_larger_error() -> None:
    data, rng = exact()[0], np.random.default_rng(2)
    errors = rng.normal(size=data.uvd_px.shape)
    for k in range(data.n_frames):
        own = np.flatnonzero(data.frame == k)
        shared = 0.6 * np.exp(-cdist(data.uvd_px[own, :2], data.uvd_px[own, :2]) / 8.0)
        errors[own, 2] = np.linalg.cholesky(shared + 0.4 * np.eye(len(own))) @ rng.normal(size=len(own))
        if k == 7:
            frame_7, expected = own, 0.4 + shared.sum(axis=1)
    found = measured(errors)
    assert found.shared[1] == pytest.approx(0.6, abs=0.15)
    assert found.length_px[1] == pytest.approx(8.0, rel=0.3)
    assert found.shared[0] * np.exp(-3.0 / found.length_px[0]) < 0.05
    np.testing.assert_allclose(found.variance(data)[frame_7, 2].mean(), expected.mean(), rtol=0.2)


def test_too_few_repeated_landmarks_say_nothing() -> None:
    sequence = generate(replace(SCENE, frames=4, landmarks=6, detection=0.5), 0)
    data = motion_data(sequence.tracks, Backend())
    zeros = np.zeros((len(data.frame), 3))
    assert measure_correlation(data, zeros, np.zeros((len(zeros), 3, 3)), np.zeros((4, 4))) is None


def test_turns_are_half_as_seen_in_the_light_and_half_as_seen_by_the_camera() -> None:
    R = np.stack([np.eye(3), exp_so3([0.0, 0.0, 0.5]), exp_so3([0.0, 1.0, 0.0])])
    still = np.broadcast_to(np.eye(3), R.shape)
    turn_rad = turns_between(R, still)
    np.testing.assert_allclose(turn_rad[0], [0.0, np.sin(0.25), np.sin(0.5)], atol=1e-12)
    np.testing.assert_allclose(turns_between(R, R)[0, 1], 2.0 * np.sin(0.25), atol=1e-12)
    np.testing.assert_allclose(turn_rad, turn_rad.T, atol=1e-12)
