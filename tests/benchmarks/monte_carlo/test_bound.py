"""The bound is what an estimate at the truth states, and what errors of honest estimates are like."""

from dataclasses import replace

import numpy as np

from benchmarks.monte_carlo.bound import (
    COMPONENTS,
    _states,
    _traces,
    cramer_rao_bound,
    errors_of,
    normalised_squares,
)
from polhode.backend import estimate_motion, initialize_motion
from polhode.config.backend_settings import Backend
from polhode.lie import Array
from polhode.progress import Silent
from polhode.records import MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, generate

SCENE = SyntheticScene(
    frames=24, landmarks=250, detection=0.5, J_G=np.diag([1.5, 1.2, 0.9]), w_G=(0.5, 0.6, 0.5), dt_s=1.0
)
CONFIG = Backend(solver="gauss_newton", process_noise="given", light_px=0.0)


def stated_mean_squares(estimate: MotionEstimate) -> Array:
    """(5,) as ``Bound.mean_squares`` without the inertia, from the estimate's own covariance."""
    return np.array([*_traces(_states(estimate)), np.trace(estimate.mass.cov_com_G)])


def test_the_bound_is_the_average_of_the_stated_covariances() -> None:
    bounds, stated, nees = [], [], []
    for seed in range(3):
        sequence = generate(SCENE, seed)
        initial = initialize_motion(sequence.tracks, sequence.relative, CONFIG)
        estimate = estimate_motion(sequence.tracks, initial, CONFIG, Silent())
        bounds.append(cramer_rao_bound(sequence, CONFIG).mean_squares)
        stated.append(stated_mean_squares(estimate))
        nees.append(normalised_squares(errors_of(estimate, sequence, CONFIG), estimate) / COMPONENTS)
    np.testing.assert_allclose(np.mean(stated, axis=0), np.mean(bounds, axis=0)[:5], rtol=0.06)
    # 3 sequences: a mean of some 12 to 200 degrees of freedom
    assert np.all(np.mean(nees, axis=0) < 2.5) and np.all(np.mean(nees, axis=0) > 0.2)


def test_the_bound_falls_with_the_pixel_noise_down_to_the_process_noise() -> None:
    coarse, fine, finest = (
        cramer_rao_bound(generate(replace(SCENE, sigma_uv_px=s, sigma_d_px=s), 0), CONFIG).mean_squares
        for s in (1.0, 0.1, 0.01)
    )
    assert np.all(fine < coarse)
    assert np.all(finest < fine)
    # a hundredth of the pixel noise is not worth much: the disturbances limit what a free body can tell
    assert np.all(coarse < 50.0**2 * finest) and np.all(finest > 0.2 * fine)


def test_outliers_carry_no_information() -> None:
    clean = generate(SCENE, 1)
    spoilt = replace(clean, outlier=np.arange(len(clean.outlier)) % 5 == 0)
    assert np.all(
        cramer_rao_bound(spoilt, CONFIG).mean_squares > cramer_rao_bound(clean, CONFIG).mean_squares
    )


def test_correlated_frames_count_less_than_their_number() -> None:
    freedom = cramer_rao_bound(generate(SCENE, 2), CONFIG).freedom
    assert np.all(freedom[:4] > 2.99) and np.all(freedom[:4] < 3.0 * SCENE.frames)
    np.testing.assert_array_equal(freedom[4:], [3.0, 5.0])
