"""Sigmas of features and matches: larger where texture is blunt and where a match is doubtful."""

import numpy as np

from polhode.frontend.features.feature_noise import confidence_logit, feature_sigma, match_sigma
from polhode.frontend.features.stereo import StereoFeatures
from polhode.train.feature_noise import MatchResiduals, fit_noise, normalised_variance


def _features(sigma_ls_px: list[float]) -> StereoFeatures:
    n = len(sigma_ls_px)
    sigma = feature_sigma(np.array(sigma_ls_px))
    return StereoFeatures(
        np.zeros((n, 3)), sigma, np.zeros((n, 3)), np.ones(n), np.zeros((n, 128), np.float32)
    )


def test_sharp_texture_is_more_certain() -> None:
    sharp, blunt = feature_sigma(np.array([0.03, 0.2]))
    assert np.all(sharp < blunt)
    assert sharp[0] == sharp[1]
    # What least squares call exact is not believed.
    assert np.array_equal(feature_sigma(np.array([0.0])), feature_sigma(np.array([0.005])))


def test_a_sure_match_is_more_certain_than_a_doubtful_one() -> None:
    a, b = _features([0.05, 0.05]), _features([0.05, 0.05])
    doubtful, sure = match_sigma(a, b, np.array([[0, 1], [1, 0]]), np.array([0.01, 0.9]))
    assert np.all(sure < doubtful)
    assert np.all(np.isfinite(match_sigma(a, b, np.array([[0, 0], [1, 1]]), np.array([0.0, 1.0]))))


def test_the_fit_finds_the_noise_that_was_put_in() -> None:
    """Two scenes of different sharpness; floor 0.2 px, gain 2 px, and less noise for sure matches."""
    rng = np.random.default_rng(0)
    scenes = []
    for middle in (0.04, 0.12):
        sharp = middle * np.exp(rng.normal(0.0, 0.4, (6000, 2)))
        logit = rng.normal(0.0, 2.0, 6000)
        variance = (0.08 + 2.0 * np.sum(sharp, axis=1)) * np.exp(-0.2 * logit)
        residual = rng.normal(size=(6000, 3)) * np.sqrt(variance)[:, None]
        scenes.append(
            MatchResiduals(residual, np.sqrt(np.repeat(variance[:, None], 3, axis=1)), sharp, logit)
        )
    found = fit_noise(scenes, (0, 1))
    # Without the confidence its mean effect, exp(0.08), is in the gain; the confidence takes it back.
    assert abs(found.gain_px * np.exp(found.confidence[0]) - 2.0) < 0.1
    assert abs(found.floor_px * np.exp(0.5 * found.confidence[0]) - 0.2) < 0.03
    assert abs(found.confidence[1] + 0.2) < 0.02
    assert all(abs(value - 1.0) < 0.06 for scene in scenes for value in normalised_variance(scene))


def test_the_logit_is_finite_everywhere() -> None:
    assert np.isfinite(confidence_logit(np.array([0.0, 0.5, 1.0]))).all()
    assert confidence_logit(np.array([0.5]))[0] == 0.0
