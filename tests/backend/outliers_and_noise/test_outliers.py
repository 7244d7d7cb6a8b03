"""What contradicts the motion leaves, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.outliers_and_noise.outliers import (
    estimate_noise,
    prune,
    remove_outliers,
    whitened_residuals,
)
from polhode.backend.problem.inertia import FORMS
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.config.backend_settings import Backend
from polhode.errors import RunFailure
from polhode.records import Bools
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

SCENE = SyntheticScene(frames=20, landmarks=300, detection=0.4, outliers=0.1, J_G=np.diag([1.5, 1.2, 0.9]))


def at_truth(sequence: SyntheticSequence) -> tuple[MotionData, Iterate]:
    data, truth = motion_data(sequence.tracks, Backend()), sequence.truth
    R_NG, p_NG = sequence.X_NG[:, :3, :3], sequence.X_NG[:, :3, 3]
    w_G = np.einsum("fba,fb->fa", R_NG, np.einsum("fab,fb->fa", truth.R_NP, truth.w_P))
    J = truth.R_GP @ np.diag(truth.moments) @ truth.R_GP.T
    xi, R_inertia = FORMS["second_moments"].coordinates(0.5 * np.trace(J) * np.eye(3) - J)
    iterate = Iterate(p_NG, R_NG, truth.v_N, w_G, truth.com_G, xi, R_inertia, sequence.p_G)
    return data, iterate


def sorted_outliers(sequence: SyntheticSequence, data: MotionData) -> Bools:
    return sequence.outlier[data.order]


def test_the_truth_keeps_its_inliers_and_loses_gross_errors() -> None:
    sequence = generate(SCENE, 0)
    data, iterate = at_truth(sequence)
    kept = prune(data, iterate)
    wrong = sorted_outliers(sequence, data)
    norm = np.linalg.norm(whitened_residuals(data, iterate), axis=1)
    assert np.mean(kept.observations[~wrong]) > 0.95
    assert not np.any(kept.observations[norm > 4.5])


def test_the_smaller_problem_holds_the_same_measurements() -> None:
    data, iterate = at_truth(generate(SCENE, 1))
    kept = prune(data, iterate)
    np.testing.assert_array_equal(kept.data.uvd_px, data.uvd_px[kept.observations])
    assert kept.data.n_landmarks == kept.landmarks.sum() == kept.data.landmark.max() + 1
    assert np.all(np.diff(kept.data.start) > 0)
    np.testing.assert_allclose(
        whitened_residuals(kept.data, kept.restrict(iterate)),
        whitened_residuals(data, iterate)[kept.observations],
        atol=1e-12,
    )


def test_landmarks_that_left_stay_where_they_were() -> None:
    data, iterate = at_truth(generate(SCENE, 2))
    kept = prune(data, iterate)
    moved = replace(kept.restrict(iterate), p_G=kept.restrict(iterate).p_G + 1.0)
    whole = kept.expand(moved, iterate)
    np.testing.assert_array_equal(whole.p_G[~kept.landmarks], iterate.p_G[~kept.landmarks])
    np.testing.assert_array_equal(whole.p_G[kept.landmarks], iterate.p_G[kept.landmarks] + 1.0)


def test_a_landmark_that_loses_most_of_its_observations_leaves() -> None:
    data, iterate = at_truth(generate(replace(SCENE, outliers=0.0), 3))
    mark = int(np.flatnonzero(np.diff(data.start) == 5)[0])
    uvd = data.uvd_px.copy()
    uvd[data.start[mark] : data.start[mark] + 3] += 30.0
    kept = prune(replace(data, uvd_px=uvd), iterate)
    assert not kept.landmarks[mark]
    assert not kept.observations[data.start[mark] : data.start[mark + 1]].any()


def test_the_noise_is_found_whatever_was_stated_and_in_spite_of_outliers() -> None:
    sequence = generate(replace(SCENE, landmarks=600, detection=0.6, sigma_uv_px=0.5, sigma_d_px=0.2), 4)
    data, iterate = at_truth(sequence)
    stated = data.rescaled(np.array([0.6, 0.6, 2.0]))
    robust = estimate_noise(stated, iterate, robust=True)
    _, kept, _, scales = remove_outliers(stated, iterate)
    assert scales.uv == pytest.approx(1 / 0.6, rel=0.05)
    assert scales.disparity == pytest.approx(0.5, rel=0.05)
    # without a fit the residuals are the noise itself: the correction for freedom makes them too large
    assert robust.uv > 1 / 0.6
    assert np.std(whitened_residuals(kept.data, kept.restrict(iterate))) == pytest.approx(1.0, abs=0.06)


def test_a_motion_that_most_observations_contradict_fails() -> None:
    data, iterate = at_truth(generate(SCENE, 5))
    turned = replace(iterate, p_NG=iterate.p_NG + 0.05 * np.random.default_rng(0).normal(size=(20, 3)))
    with pytest.raises(RunFailure, match="no consistent motion: only"):
        prune(data, turned)
