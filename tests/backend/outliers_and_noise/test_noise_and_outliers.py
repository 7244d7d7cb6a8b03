"""What contradicts the motion leaves, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.outliers_and_noise.noise_and_outliers import (
    estimate_noise,
    prune,
    remove_outliers,
    whitened_residuals,
)
from polhode.runtime.errors import RunFailure
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.backend.motions import BOX, at_truth

SCENE = SyntheticScene(frames=20, landmarks=300, detection=0.4, outliers=0.1, J_G=BOX)


def test_the_truth_loses_gross_errors_and_the_smaller_problem_holds_the_other_measurements() -> None:
    sequence = generate(SCENE, 0)
    fit = at_truth(sequence)
    data, iterate, kept, whole = fit.data, fit.iterate, prune(fit), whitened_residuals(fit)
    assert np.mean(kept.observations[~sequence.outlier[data.order]]) > 0.95
    assert not np.any(kept.observations[np.linalg.norm(whole, axis=1) > 4.5])
    np.testing.assert_array_equal(kept.data.uvd_px, data.uvd_px[kept.observations])
    assert kept.data.n_landmarks == kept.landmarks.sum() == kept.data.landmark.max() + 1
    assert np.all(np.diff(kept.data.start) > 0)
    small = whitened_residuals(kept.restrict(iterate))
    np.testing.assert_allclose(small, whole[kept.observations], atol=1e-12)
    moved = replace(iterate, p_G=kept.restrict(iterate).iterate.p_G + 1.0)
    p_G = kept.expand(moved, iterate).p_G
    np.testing.assert_array_equal(p_G, iterate.p_G + kept.landmarks[:, None])


def test_a_landmark_that_loses_most_of_its_observations_leaves() -> None:
    fit = at_truth(generate(replace(SCENE, outliers=0.0), 3))
    start, uvd = fit.data.start, fit.data.uvd_px.copy()
    mark = int(np.flatnonzero(np.diff(start) == 5)[0])
    uvd[start[mark] : start[mark] + 3] += 30.0
    kept = prune(fit.with_data(uvd_px=uvd))
    assert not kept.landmarks[mark] and not kept.observations[start[mark] : start[mark + 1]].any()


def test_the_noise_is_found_whatever_was_stated_and_in_spite_of_outliers() -> None:
    fit = at_truth(generate(replace(SCENE, landmarks=600, detection=0.6, sigma_uv_px=0.5, sigma_d_px=0.2), 4))
    stated = replace(fit, data=fit.data.rescaled(np.array([0.6, 0.6, 2.0])))
    found = remove_outliers(stated)
    assert found.scales[0] == pytest.approx(1 / 0.6, rel=0.05)
    assert found.scales[2] == pytest.approx(0.5, rel=0.05)
    # without a fit the residuals are the noise itself: the correction for freedom makes them too large
    assert estimate_noise(stated, robust=True)[0] > 1 / 0.6
    assert np.std(whitened_residuals(found.kept.restrict(fit.iterate))) == pytest.approx(1.0, abs=0.06)


def test_a_motion_that_most_observations_contradict_fails() -> None:
    fit = at_truth(generate(SCENE, 5))
    p_NG = fit.iterate.p_NG + 0.05 * np.random.default_rng(0).normal(size=(20, 3))
    with pytest.raises(RunFailure, match="no consistent motion: only"):
        prune(replace(fit, iterate=replace(fit.iterate, p_NG=p_NG)))
