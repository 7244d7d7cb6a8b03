"""The estimator from a cold start: errors against its own sigmas, solvers against each other, hard cases."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.initialization.multistart import initial_guesses, try_hypothesis
from polhode.backend.problem.motion_data import motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.solve import refine
from polhode.config.backend_settings import Backend, CorrelatedErrors
from polhode.geometry.lie import Array, Bools, exp_so3, inverse_pose, log_so3, make_pose, transform_points
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import BOX, FAST, TUMBLE, deviations, estimated, nees, sigmas, state_errors

GAP = range(18, 34)
SCENE = SyntheticScene(
    frames=50, landmarks=200, detection=0.5, w_G=(0.3, 0.45, 0.35), J_G=BOX,
    sigma_uv_px=0.3, sigma_d_px=0.3, accel_psd=1e-9, torque_psd=1e-9, dropped=tuple(GAP),
)  # fmt: skip
STILL = Backend(solver="gauss_newton", accel_psd=1e-9, torque_psd=1e-9)
NO_SHARED = FAST.model_copy(update={"systematic_px": (0.0, 0.0, 0.0), "light_px": 0.0})


def test_what_the_covariance_knows_of_correlated_errors_changes_sigmas_alone() -> None:
    sequence = generate(replace(TUMBLE, frames=24, sigma_uv_px=0.2, sigma_d_px=0.2), 3)
    kinds: tuple[CorrelatedErrors, ...] = ("none", "neighbours", "drift", "slide")
    configs = [FAST.model_copy(update={"correlated_errors": k, "light_px": 0.3}) for k in kinds]
    found = [estimated(sequence, config) for config in configs]
    for other in found[1:]:
        np.testing.assert_array_equal(other.r_N, found[0].r_N)
    # the errors of this sequence are independent: only the slide, which no data show, adds to the sigmas
    for at in (slice(0, 3), slice(9, 12)):
        size = np.array([np.sqrt((sigmas(each.covariance)[:, at] ** 2).mean()) for each in found])
        np.testing.assert_allclose(size[1:3], size[0], rtol=0.25)
        assert size[3] > 1.05 * size[2]
    without_light = estimated(sequence, FAST.model_copy(update={"light_px": 0.0}))
    assert np.trace(without_light.covariance[-1]) < np.trace(found[3].covariance[-1])


@pytest.mark.parametrize("inertia", ["second_moments", "ratios_axes"])
def test_cold_start_ends_within_its_own_sigmas(inertia: str) -> None:
    sequence = generate(TUMBLE, 0)
    estimate = estimated(sequence, Backend.model_validate({"inertia": inertia}))
    mass, truth = estimate.mass, sequence.truth
    assert estimate.solver.converged
    assert mass.identifiable.k1 and mass.identifiable.k2 and mass.identifiable.com and mass.identifiable.axes
    assert abs(mass.k1 - truth.k1) < 4.0 * np.sqrt(mass.cov_k[0, 0]) < 0.05
    assert abs(mass.k2 - truth.k2) < 4.0 * np.sqrt(mass.cov_k[1, 1]) < 0.05
    in_G = transform_points(inverse_pose(estimate.X_NG), truth.r_N[:, None])[:, 0]
    assert np.all(np.abs(mass.com_G - in_G.mean(axis=0)) < 4.0 * np.sqrt(np.diag(mass.cov_com_G)))
    assert np.mean(np.abs(deviations(sequence, estimate)) < 3.0) > 0.97
    assert estimate.solver.reduced_chi2 == pytest.approx(1.0, abs=0.15)


def test_errors_are_as_large_as_the_covariance_says() -> None:
    values = []
    for seed in range(10, 16):
        sequence = generate(TUMBLE, seed)
        estimate = estimated(sequence)
        values.append(nees(state_errors(sequence, estimate), estimate.covariance))
    # 12 x 6 correlated sequences: the band is wide, but a sigma wrong by 1.6 falls outside
    assert 0.6 < np.mean(values) < 1.6


def test_both_inertia_forms_and_both_solvers_reach_the_same_optimum() -> None:
    sequence = generate(replace(TUMBLE, outliers=0.05), 1)
    initial = initialize_motion(sequence.tracks, sequence.relative, FAST)
    costs, inertias = [], []
    for form, solver in (
        ("second_moments", MotionProgram),
        ("ratios_axes", MotionProgram),
        ("second_moments", GaussNewton),
    ):
        data = motion_data(sequence.tracks, Backend.model_validate({"inertia": form}))
        start = initial_guesses(sequence.tracks, initial, data)[0]
        trial = try_hypothesis(MotionFit(data, start.iterate), start, np.diag([1.0, 1.3, 1.6]), [])
        assert trial is not None
        # the whitening follows the rate: a second round lets it come to rest
        rough, _, _ = refine(solver(data), trial.iterate, 100)
        iterate, solution, _ = refine(solver(data), rough, 100)
        costs.append(solution.cost)
        # in N at the first frame: G itself is free
        J_N = iterate.R_NG[0] @ iterate.J_G(data.form) @ iterate.R_NG[0].T
        inertias.append(J_N / np.trace(J_N))
    np.testing.assert_allclose(costs, costs[0], rtol=1e-6)
    for J in inertias[1:]:
        np.testing.assert_allclose(J, inertias[0], atol=2e-5)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_noise_is_recovered_and_outliers_get_no_weight_and_do_no_harm(share: float) -> None:
    sequence = generate(replace(TUMBLE, sigma_uv_px=0.4, sigma_d_px=0.2, outliers=share), 3)
    wrong = replace(sequence.tracks, sigma_px=np.ones_like(sequence.tracks.sigma_px))
    estimate = estimated(replace(sequence, tracks=wrong))
    assert estimate.noise.pixel_sigma_px == pytest.approx(0.4, rel=0.12)
    assert estimate.noise.disparity_sigma_px == pytest.approx(0.2, rel=0.12)
    assert np.median(estimate.inlier_weight[sequence.outlier]) < 0.1 < np.median(estimate.inlier_weight)
    assert abs(estimate.mass.k2 - sequence.truth.k2) < 4.0 * np.sqrt(estimate.mass.cov_k[1, 1])


def test_ten_seconds_without_measurements_are_bridged_and_the_sigma_grows() -> None:
    gap = range(30, 50)
    sequence = generate(replace(TUMBLE, frames=80, dropped=tuple(gap), sigma_uv_px=0.4, sigma_d_px=0.4), 4)
    estimate = estimated(sequence)
    sigma, errors = sigmas(estimate.covariance), state_errors(sequence, estimate)
    assert np.mean(np.abs(errors / sigma) < 3.0) > 0.97
    assert np.abs(errors[list(gap), 6:9]).max() < np.deg2rad(3.0)
    # in the middle of the gap, and on either side of it
    for component, growth in ((slice(0, 3), 4.0), (slice(6, 9), 1.5)):
        size = np.linalg.norm(sigma[:, component], axis=1)
        assert size[40] > growth * max(size[20], size[60])
    assert any("20 frames without measurements were bridged" in text for text in estimate.warnings)


def test_a_tumble_of_more_than_half_a_turn_a_frame_is_told_or_called_ambiguous() -> None:
    axis = np.array([0.5, 0.7, 0.5]) / np.linalg.norm([0.5, 0.7, 0.5])
    scene = replace(TUMBLE, frames=24, landmarks=200, detection=0.6, sigma_uv_px=0.3, sigma_d_px=0.3)
    for turn_deg, ambiguous in ((220.0, False), (190.0, True)):
        w_G = 2.0 * np.deg2rad(turn_deg) * axis
        sequence = generate(replace(scene, w_G=tuple(w_G.tolist())), int(turn_deg))
        estimate = estimated(sequence)
        assert ambiguous == (len(estimate.hypotheses) == 2)
        known = estimate.mass.identifiable
        assert known.k1 == known.k2 == known.axes == (not ambiguous)
        if ambiguous:
            sigma = sigmas(estimate.covariance)
            assert np.all(np.isinf(sigma[:, 9:])) and np.all(np.isfinite(sigma[:, :6]))
            assert np.all(np.isinf(known.sigma[3:])) and np.all(np.isfinite(known.sigma[:3]))
            # the true motion is one of them
            rates = [each.R_NG @ each.w_G for each in estimate.hypotheses]
            true_N = sequence.truth.R_NP[-1] @ sequence.truth.w_P[-1]
            assert min(np.linalg.norm(rate - true_N) for rate in rates) < np.deg2rad(2.0)
        else:
            assert abs(estimate.mass.k2 - sequence.truth.k2) < 4.0 * np.sqrt(estimate.mass.cov_k[1, 1])


def test_a_landmark_seen_once_is_kept_with_a_large_sigma() -> None:
    sequence = generate(TUMBLE, 8)
    landmark = sequence.tracks.landmark.copy()
    often = np.flatnonzero(np.bincount(landmark)[landmark] >= 5)[::40]
    once = landmark.max() + 1 + np.arange(len(often))
    landmark[often] = once
    estimate = estimated(replace(sequence, tracks=replace(sequence.tracks, landmark=landmark)))
    count, sigma = np.bincount(landmark), estimate.landmarks.sigma_m
    assert len(sigma) == len(count)
    assert np.all(estimate.landmarks.observations[once] <= 1)
    assert np.median(sigma[once]) > 2.0 * np.median(sigma[count >= 4])
    assert any("landmarks were seen only once" in text for text in estimate.warnings)


def test_the_same_input_gives_the_same_bytes() -> None:
    sequence = generate(replace(TUMBLE, frames=12), 10)
    first, second = estimated(sequence, Backend()), estimated(sequence, Backend())
    assert first.r_N.tobytes() == second.r_N.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()


def test_measurements_without_any_consistent_motion_fail_the_run() -> None:
    sequence = generate(replace(TUMBLE, frames=12), 11)
    rng = np.random.default_rng(0)
    nonsense = replace(sequence.tracks, uvd_px=rng.uniform(20.0, 400.0, sequence.tracks.uvd_px.shape))
    X = inverse_pose(sequence.tracks.X_NR) @ sequence.X_NG
    with pytest.raises(RunFailure, match="no consistent motion"):
        estimate_motion(nonsense, InitialMotion(X, np.ones(len(X), bool)), FAST, Silent())


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(SCENE, 3)


def _with_look_alike(sequence: SyntheticSequence, turned: Bools) -> tuple[StereoTracks, InitialMotion]:
    """Frames ``turned`` (F,) are a third of a turn off, and their features were taken for other ones."""
    tracks = sequence.tracks
    landmark = tracks.landmark.copy()
    landmark[turned[tracks.frame]] += tracks.n_landmarks
    _, landmark = np.unique(landmark, return_inverse=True)
    X_RG = inverse_pose(tracks.X_NR) @ sequence.X_NG
    X_RG[turned] = X_RG[turned] @ make_pose(exp_so3([0.0, 0.0, 2.0 * np.pi / 3.0]), np.zeros(3))
    connected = ~np.isin(np.arange(SCENE.frames), GAP)
    return replace(tracks, landmark=landmark.astype(np.int64)), InitialMotion(X_RG, connected)


def _turn_off_deg(sequence: SyntheticSequence, estimate: MotionEstimate) -> Array:
    """Angle (F,) of the attitude to the truth, but for the constant rotation of the first frame."""
    D = np.swapaxes(sequence.X_NG[:, :3, :3], 1, 2) @ estimate.X_NG[:, :3, :3]
    return np.asarray(np.rad2deg(np.linalg.norm(log_so3(D[0].T @ D), axis=1)))


def test_a_stretch_that_looks_alike_is_put_right_by_the_dynamics(sequence: SyntheticSequence) -> None:
    tracks, initial = _with_look_alike(sequence, np.arange(SCENE.frames) >= GAP.stop)
    estimate = estimate_motion(tracks, initial, STILL, Silent())
    assert _turn_off_deg(sequence, estimate).max() < 1.5
    assert abs(estimate.mass.k2 - sequence.truth.k2) < 4.0 * np.sqrt(estimate.mass.cov_k[1, 1]) < 0.2
    # the frames behind the gap count again: their observations agree
    assert np.mean(estimate.inlier_weight[tracks.frame >= GAP.stop] > 0.0) > 0.9


NOISY = replace(TUMBLE, frames=60, landmarks=400, sigma_uv_px=0.3, sigma_d_px=0.3)


def test_relative_poses_that_contradict_one_another_do_not_spoil_the_whole() -> None:
    sequence = generate(replace(NOISY, outliers=0.2, wrong_pairs=0.35), 43)
    initial = initialize_motion(sequence.tracks, sequence.relative, NO_SHARED)
    # rounding does not decide where a contradicted start ends
    shifted = replace(sequence.tracks, uvd_px=sequence.tracks.uvd_px * (1.0 + 1e-12))
    again = initialize_motion(shifted, sequence.relative, NO_SHARED)
    np.testing.assert_array_equal(again.connected, initial.connected)
    np.testing.assert_allclose(again.X_RG, initial.X_RG, atol=1e-6)
    estimate = estimate_motion(sequence.tracks, initial, NO_SHARED, Silent())
    assert not initial.connected.all()
    # landmarks that the first motion put far off are triangulated again
    assert np.mean(estimate.inlier_weight[~sequence.outlier] > 0.0) > 0.95
    assert np.mean(estimate.inlier_weight[sequence.outlier] > 0.0) < 0.05
    assert _turn_off_deg(sequence, estimate).max() < 1.5
    error = np.array([estimate.mass.k1 - sequence.truth.k1, estimate.mass.k2 - sequence.truth.k2])
    assert np.all(np.abs(error) < 4.0 * np.sqrt(np.diag(estimate.mass.cov_k)))


@pytest.mark.parametrize(("accel_psd", "torque_psd"), [(1e-8, 1e-7), (1e-5, 1e-6), (1e-7, 1e-5)])
def test_full_smoothing_recovers_the_level_of_the_disturbances(accel_psd: float, torque_psd: float) -> None:
    off = []
    for seed in (20, 21):
        scene = replace(NOISY, accel_psd=accel_psd, torque_psd=torque_psd)
        noise = estimated(generate(scene, seed), NO_SHARED).noise
        off.append(np.log10([noise.accel_psd / accel_psd, noise.torque_psd / torque_psd]))
    assert np.abs(off).max() < 1.0
    assert np.abs(np.mean(off, axis=0)).max() <= 0.5
