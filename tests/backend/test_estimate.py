"""The estimator from a cold start: errors against its own sigmas, solvers against each other, hard cases."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.estimate import motions_from_fewer_frames
from polhode.backend.initialization.multistart import initial_guesses, try_hypothesis
from polhode.backend.problem.motion_data import motion_data
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.solve import refine
from polhode.config.backend_settings import Backend, CorrelatedErrors
from polhode.errors import RunFailure
from polhode.lie import Array, exp_so3, inverse_pose, log_so3, make_pose, transform_points
from polhode.progress import Silent
from polhode.records import Bools, InitialMotion, MotionEstimate, StereoTracks
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

TUMBLE = SyntheticScene(
    frames=40, landmarks=300, detection=0.4, w_G=(0.4, 0.5, 0.45), J_G=np.diag([1.5, 1.2, 0.9])
)
FAST = Backend(solver="gauss_newton")
HALF_TURNS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
GAP = range(18, 34)
SCENE = SyntheticScene(
    frames=50, landmarks=200, detection=0.5, w_G=(0.3, 0.45, 0.35), J_G=np.diag([1.5, 1.2, 0.9]),
    sigma_uv_px=0.3, sigma_d_px=0.3, accel_psd=1e-9, torque_psd=1e-9, dropped=tuple(GAP),
)  # fmt: skip
THIRD: Array = make_pose(exp_so3([0.0, 0.0, 2.0 * np.pi / 3.0]), np.zeros(3))


def run(sequence: SyntheticSequence, config: Backend = FAST) -> MotionEstimate:
    return estimate_motion(
        sequence.tracks, initialize_motion(sequence.tracks, sequence.relative, config), config, Silent()
    )


def test_what_the_covariance_knows_of_correlated_errors_changes_sigmas_alone() -> None:
    sequence = generate(replace(TUMBLE, sigma_uv_px=0.2, sigma_d_px=0.2), 3)
    kinds: tuple[CorrelatedErrors, ...] = ("none", "neighbours", "drift", "slide")
    found = [run(sequence, FAST.model_copy(update={"correlated_errors": k, "light_px": 0.3})) for k in kinds]
    for other in found[1:]:
        np.testing.assert_array_equal(other.r_N, found[0].r_N)
    position, rate = (
        np.array([np.sqrt(np.diagonal(each.covariance, axis1=1, axis2=2)[:, at].mean()) for each in found])
        for at in (slice(0, 3), slice(9, 12))
    )
    # the errors of this sequence are independent: only the slide, which no data show, adds to the sigmas
    for sigmas in (position, rate):
        np.testing.assert_allclose(sigmas[1:3], sigmas[0], rtol=0.25)
        assert sigmas[3] > 1.05 * sigmas[2]
    without_light = run(sequence, FAST.model_copy(update={"light_px": 0.0}))
    drift_alone = FAST.model_copy(update={"correlated_errors": "drift", "light_px": 0.3})
    assert np.trace(without_light.covariance[-1]) < np.trace(found[3].covariance[-1])
    np.testing.assert_array_equal(run(sequence, drift_alone).covariance, found[2].covariance)


def state_errors(sequence: SyntheticSequence, estimate: MotionEstimate) -> Array:
    """Truth minus estimate (F, 12) in the order and frames of the covariance, half-turn resolved."""
    truth = sequence.truth
    turns = [log_so3(np.swapaxes(estimate.R_NP, 1, 2) @ truth.R_NP @ np.diag(h)) for h in HALF_TURNS]
    best = int(np.argmin([np.linalg.norm(t) for t in turns]))
    w_P = truth.w_P * HALF_TURNS[best]
    return np.concatenate(
        [truth.r_N - estimate.r_N, truth.v_N - estimate.v_N, turns[best], w_P - estimate.w_P], axis=1
    )


def com_error(sequence: SyntheticSequence, estimate: MotionEstimate) -> Array:
    """Estimate minus truth (3,), in the estimate's G."""
    in_G = transform_points(inverse_pose(estimate.X_NG), sequence.truth.r_N[:, None])[:, 0]
    return np.asarray(estimate.mass.com_G - in_G.mean(axis=0))


def mean_nees(errors: Array, covariance: Array) -> float:
    """Normalised squared error, expected 1."""
    return float(np.mean([e @ np.linalg.solve(C, e) for e, C in zip(errors, covariance, strict=True)])) / 12.0


@pytest.mark.parametrize("inertia", ["second_moments", "ratios_axes"])
def test_cold_start_ends_within_its_own_sigmas(inertia: str) -> None:
    sequence = generate(TUMBLE, 0)
    estimate = run(sequence, Backend.model_validate({"inertia": inertia}))
    mass, truth = estimate.mass, sequence.truth
    assert estimate.solver.converged
    assert mass.identifiable.k1 and mass.identifiable.k2 and mass.identifiable.com and mass.identifiable.axes
    assert abs(mass.k1 - truth.k1) < 4.0 * np.sqrt(mass.cov_k[0, 0]) < 0.05
    assert abs(mass.k2 - truth.k2) < 4.0 * np.sqrt(mass.cov_k[1, 1]) < 0.05
    assert np.all(np.abs(com_error(sequence, estimate)) < 4.0 * np.sqrt(np.diag(mass.cov_com_G)))
    z = state_errors(sequence, estimate) / np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    assert np.mean(np.abs(z) < 3.0) > 0.97
    assert estimate.solver.reduced_chi2 == pytest.approx(1.0, abs=0.15)


def test_errors_are_as_large_as_the_covariance_says() -> None:
    values = []
    for seed in range(6):
        sequence = generate(TUMBLE, 10 + seed)
        estimate = run(sequence)
        values.append(mean_nees(state_errors(sequence, estimate), estimate.covariance))
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
        trial = try_hypothesis(data, start, start.iterate, np.diag([1.0, 1.3, 1.6]), [])
        assert trial is not None
        # the whitening follows the rate: a second round lets it come to rest
        rough, _, _ = refine(solver(data), data, trial.iterate, 100)
        iterate, solution, _ = refine(solver(data), data, rough, 100)
        costs.append(solution.cost)
        # in N at the first frame: G itself is free
        J_N = iterate.R_NG[0] @ iterate.J_G(data.form) @ iterate.R_NG[0].T
        inertias.append(J_N / np.trace(J_N))
    np.testing.assert_allclose(costs, costs[0], rtol=1e-6)
    np.testing.assert_allclose(inertias[1], inertias[0], atol=2e-5)
    np.testing.assert_allclose(inertias[2], inertias[0], atol=2e-5)


def test_pixel_and_disparity_noise_are_recovered() -> None:
    sequence = generate(replace(TUMBLE, sigma_uv_px=0.4, sigma_d_px=0.2), 2)
    wrong = replace(sequence.tracks, sigma_px=np.ones_like(sequence.tracks.sigma_px))
    estimate = run(replace(sequence, tracks=wrong))
    assert estimate.noise.pixel_sigma_px == pytest.approx(0.4, rel=0.08)
    assert estimate.noise.disparity_sigma_px == pytest.approx(0.2, rel=0.08)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_outliers_get_no_weight_and_do_no_harm(share: float) -> None:
    sequence = generate(replace(TUMBLE, outliers=share), 3)
    estimate = run(sequence)
    errors = np.linalg.norm(sequence.tracks.uvd_px, axis=1)
    assert len(errors) == len(estimate.inlier_weight)
    assert np.median(estimate.inlier_weight[sequence.outlier]) < 0.1 < np.median(estimate.inlier_weight)
    assert abs(estimate.mass.k2 - sequence.truth.k2) < 4.0 * np.sqrt(estimate.mass.cov_k[1, 1])


def test_ten_seconds_without_measurements_are_bridged_and_the_sigma_grows() -> None:
    gap = range(30, 50)
    sequence = generate(replace(TUMBLE, frames=80, dropped=tuple(gap), sigma_uv_px=0.4, sigma_d_px=0.4), 4)
    estimate = run(sequence)
    sigma = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    errors = state_errors(sequence, estimate)
    assert np.mean(np.abs(errors / sigma) < 3.0) > 0.97
    assert np.abs(errors[list(gap), 6:9]).max() < np.deg2rad(3.0)
    # in the middle of the gap, and on either side of it
    for component, growth in ((slice(0, 3), 4.0), (slice(6, 9), 1.5)):
        size = np.linalg.norm(sigma[:, component], axis=1)
        assert size[40] > growth * max(size[20], size[60])
    assert any("20 frames without measurements" in text for text in estimate.warnings)


def test_a_tumble_of_more_than_half_a_turn_a_frame_is_told_or_called_ambiguous() -> None:
    """Euler's equation tells the first; the second has a twin with another inertia that fits as well."""
    axis = np.array([0.5, 0.7, 0.5]) / np.linalg.norm([0.5, 0.7, 0.5])
    scene = replace(TUMBLE, frames=24, landmarks=200, detection=0.6, sigma_uv_px=0.3, sigma_d_px=0.3)
    for turn_deg, ambiguous in ((220.0, False), (190.0, True)):
        w_G = 2.0 * np.deg2rad(turn_deg) * axis
        sequence = generate(replace(scene, w_G=tuple(w_G.tolist())), int(turn_deg))
        estimate = run(sequence)
        said = any("direction of rotation is ambiguous" in text for text in estimate.warnings)
        assert said == ambiguous
        known = estimate.mass.identifiable
        assert known.k1 == known.k2 == known.axes == (not ambiguous)
        if ambiguous:
            assert np.all(np.isinf(np.diagonal(estimate.covariance, axis1=1, axis2=2)[:, 9:]))
            assert np.all(np.isfinite(np.diagonal(estimate.covariance, axis1=1, axis2=2)[:, :6]))
            assert np.all(np.isinf(known.sigma[3:])) and np.all(np.isfinite(known.sigma[:3]))
        else:
            assert abs(estimate.mass.k2 - sequence.truth.k2) < 4.0 * np.sqrt(estimate.mass.cov_k[1, 1])


def test_a_frame_without_measurements_is_bridged_with_a_larger_sigma() -> None:
    sequence = generate(replace(TUMBLE, dropped=tuple(range(16, 26))), 4)
    estimate = run(sequence)
    sigma = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    whole = run(generate(TUMBLE, 4))
    seen = np.sqrt(np.diagonal(whole.covariance, axis1=1, axis2=2))
    growth = np.linalg.norm(sigma[:, :3], axis=1) / np.linalg.norm(seen[:, :3], axis=1)
    assert growth[20] > 1.15 * max(growth[5], growth[35]) > 1.15
    assert np.all(np.abs(state_errors(sequence, estimate)[16:26]) < 5.0 * sigma[16:26])
    assert any("without measurements" in text for text in estimate.warnings)


def test_pure_spin_leaves_the_right_directions_undetermined() -> None:
    J = np.diag([1.6, 1.2, 1.0])
    scene = replace(TUMBLE, J_G=J, w_G=(0.8, 0.0, 0.0), torque_psd=1e-12)
    sequence = generate(scene, 5)
    estimate = run(sequence, Backend(solver="gauss_newton", torque_psd=1e-12))
    known = estimate.mass.identifiable
    assert not known.com and not known.axes and not (known.k1 and known.k2)
    spin = int(np.argmax(np.mean(estimate.w_P**2, axis=0)))
    assert not known.com_P[spin]
    assert np.isinf(estimate.mass.cov_k).any() and np.isinf(np.diag(estimate.mass.cov_R_GP)).any()
    assert (
        np.all(np.isfinite(estimate.r_N))
        and np.all(np.isfinite(estimate.R_NP))
        and np.isfinite(estimate.mass.k1)
    )
    assert np.all(np.isfinite(estimate.covariance[:, 3:6, 3:6]))


def test_a_target_at_rest_gives_finite_numbers_and_claims_nothing() -> None:
    sequence = generate(replace(TUMBLE, frames=20, w_G=(0.0, 0.0, 0.0), torque_psd=1e-12), 6)
    estimate = run(sequence)
    known = estimate.mass.identifiable
    assert not (known.k1 or known.k2 or known.com or known.axes)
    assert np.all(np.isfinite(estimate.r_N)) and np.all(np.isfinite(estimate.mass.J_G))
    assert all("not determined" in text for text in known.detail.values())


def test_three_frames_are_enough_to_return_an_estimate() -> None:
    estimate = run(generate(replace(TUMBLE, frames=3), 7))
    assert np.all(np.isfinite(estimate.r_N)) and np.all(np.isfinite(estimate.landmarks.sigma_m))


def test_a_landmark_seen_once_is_kept_with_a_large_sigma() -> None:
    sequence = generate(TUMBLE, 8)
    landmark = sequence.tracks.landmark.copy()
    often = np.flatnonzero(np.bincount(landmark)[landmark] >= 5)[::40]
    once = landmark.max() + 1 + np.arange(len(often))
    landmark[often] = once
    estimate = run(replace(sequence, tracks=replace(sequence.tracks, landmark=landmark)))
    count = np.bincount(landmark)
    sigma = estimate.landmarks.sigma_m
    assert len(sigma) == len(count)
    assert np.all(estimate.landmarks.observations[once] <= 1)
    assert np.median(sigma[once]) > 2.0 * np.median(sigma[count >= 4])
    assert any("landmarks were seen only once" in text for text in estimate.warnings)


def test_the_covariance_holds_G_at_the_first_frame_but_not_the_centre_of_mass() -> None:
    estimate = run(generate(TUMBLE, 9))
    first, last = np.diag(estimate.covariance[0])[:3], np.diag(estimate.covariance[-1])[:3]
    assert np.all(first > 1e-10) and np.all(first < 30.0 * last)
    joint = estimate.covariance_last_joint[:12, :12]
    np.testing.assert_allclose(joint[:6], estimate.covariance[-1][:6], rtol=1e-9)
    # what the first order neglects of the axes is added to the states that are reported, and is small here
    neglected = estimate.covariance[-1][6:, 6:] - joint[6:, 6:]
    assert np.linalg.eigvalsh(neglected).min() > -1e-12
    assert np.all(np.diag(neglected) < 0.1 * np.diag(joint[6:, 6:]))
    np.testing.assert_allclose(estimate.covariance_last_joint[17:, 17:], estimate.mass.cov_com_G, rtol=1e-9)


def test_the_same_input_gives_the_same_bytes() -> None:
    sequence = generate(replace(TUMBLE, frames=12), 10)
    first, second = run(sequence, Backend()), run(sequence, Backend())
    assert first.r_N.tobytes() == second.r_N.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()


def test_measurements_without_any_consistent_motion_fail_the_run() -> None:
    sequence = generate(replace(TUMBLE, frames=12), 11)
    rng = np.random.default_rng(0)
    nonsense = replace(sequence.tracks, uvd_px=rng.uniform(20.0, 400.0, sequence.tracks.uvd_px.shape))
    X = inverse_pose(sequence.tracks.X_NR) @ sequence.X_NG
    initial = InitialMotion(X, np.ones(len(X), bool))
    with pytest.raises(RunFailure, match="no consistent motion"):
        estimate_motion(nonsense, initial, FAST, Silent())


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
    X_RG[turned] = X_RG[turned] @ THIRD
    connected = ~np.isin(np.arange(SCENE.frames), GAP)
    return replace(tracks, landmark=landmark.astype(np.int64)), InitialMotion(X_RG, connected)


def _turn_off_deg(sequence: SyntheticSequence, estimate: MotionEstimate) -> Array:
    """Angle (F,) of the attitude to the truth, but for the constant rotation of the first frame."""
    D = np.swapaxes(sequence.X_NG[:, :3, :3], 1, 2) @ estimate.X_NG[:, :3, :3]
    return np.asarray(np.rad2deg(np.linalg.norm(log_so3(D[0].T @ D), axis=1)))


def test_a_stretch_that_looks_alike_is_put_right_by_the_dynamics(sequence: SyntheticSequence) -> None:
    tracks, initial = _with_look_alike(sequence, np.arange(SCENE.frames) >= GAP.stop)
    config = Backend(solver="gauss_newton", accel_psd=1e-9, torque_psd=1e-9)
    estimate = estimate_motion(tracks, initial, config, Silent())
    assert _turn_off_deg(sequence, estimate).max() < 1.5
    assert abs(estimate.mass.k2 - sequence.truth.k2) < 4.0 * np.sqrt(estimate.mass.cov_k[1, 1]) < 0.2
    # the frames behind the gap count again: their observations agree
    assert np.mean(estimate.inlier_weight[tracks.frame >= GAP.stop] > 0.0) > 0.9


def test_a_motion_without_contradictions_is_left_alone(sequence: SyntheticSequence) -> None:
    tracks, initial = _with_look_alike(sequence, np.zeros(SCENE.frames, bool))
    config = Backend(solver="gauss_newton", accel_psd=1e-9, torque_psd=1e-9)
    estimate = estimate_motion(tracks, initial, config, Silent())
    assert np.mean(estimate.inlier_weight > 0.0) > 0.98
    assert _turn_off_deg(sequence, estimate).max() < 1.5


def test_first_motions_of_rich_frames_and_of_stretches(sequence: SyntheticSequence) -> None:
    tracks, initial = _with_look_alike(sequence, np.zeros(SCENE.frames, bool))
    poor = np.isin(tracks.frame, [2, 3, 40]) & (np.arange(len(tracks.frame)) % 10 > 0)
    thinned = replace(
        tracks,
        frame=tracks.frame[~poor],
        landmark=tracks.landmark[~poor],
        uvd_px=tracks.uvd_px[~poor],
        sigma_px=tracks.sigma_px[~poor],
    )
    frames = np.arange(SCENE.frames)
    known = [first.connected for first in motions_from_fewer_frames(thinned, initial)]
    assert len(known) == 3
    np.testing.assert_array_equal(known[0], initial.connected & ~np.isin(frames, [2, 3, 40]))
    first, last = sorted(known[1:], key=lambda k: int(np.argmax(k)))
    np.testing.assert_array_equal(first, frames < GAP.start)
    np.testing.assert_array_equal(last, frames >= GAP.stop)
    # nothing to leave out where there is no gap and every frame is rich
    whole = replace(initial, connected=frames < GAP.start)
    assert motions_from_fewer_frames(tracks, whole) == []
