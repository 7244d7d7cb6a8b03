"""Cold starts, all noise estimated: gross outliers, ten seconds of nothing, an inspector that jitters."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.monte_carlo.convergence import missed
from benchmarks.monte_carlo.robustness import PLACED_M, PLACED_RAD, measure
from benchmarks.record import Case
from polhode.backend import estimate_motion, initialize_motion
from polhode.config.backend_settings import Backend
from polhode.lie import Array, inverse_pose, log_so3
from polhode.progress import Silent
from polhode.records import InitialMotion, MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

SEEDS = (100, 101, 102)
"""Not those of the benchmark."""
SCENE = SyntheticScene(
    frames=60, landmarks=400, detection=0.4, w_G=(0.4, 0.5, 0.45), J_G=np.diag([1.5, 1.2, 0.9]),
    sigma_uv_px=0.3, sigma_d_px=0.3,
)  # fmt: skip


def lines_of(condition: str, frames: int = 40) -> list[Case]:
    """What the benchmark measures, three sequences of a triaxial tumble."""
    cases = [{"condition": condition, "motion": "triaxial tumble, 7 RPM", "seed": seed} for seed in SEEDS]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("benchmarks.monte_carlo.robustness.FRAMES", frames)
        return [{"case": case, **measure(case)} for case in cases]


def run(sequence: SyntheticSequence) -> tuple[InitialMotion, MotionEstimate]:
    config = Backend(solver="gauss_newton", systematic_px=(0.0, 0.0, 0.0), light_px=0.0)
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    return initial, estimate_motion(sequence.tracks, initial, config, Silent())


def of(lines: list[Case], name: str) -> Array:
    return np.array([line[name] for line in lines])


def deviations(lines: list[Case]) -> Array:
    """Errors of com, k1, k2 and axes over the stated sigmas (3, 8): all of them are stated."""
    return np.asarray(of(lines, "errors") / of(lines, "sigma").astype(float))


def assert_consistent(lines: list[Case]) -> None:
    """Everything was found, and the errors are no larger than stated: nothing else is wrong with the runs."""
    assert not any(missed(line) for line in lines)
    assert np.abs(deviations(lines)).max() < 4.0
    assert of(lines, "inside").min() > 0.97
    # the noise of the pixels, though it is estimated from few observations of each landmark
    assert np.all((of(lines, "pixels") > 0.9) & (of(lines, "pixels") < 1.2))


def test_three_of_ten_observations_may_be_gross_errors() -> None:
    lines = lines_of("outliers")
    assert_consistent(lines)
    # as good as the seven that are left allow
    over = np.sqrt(np.mean(of(lines, "squares") / of(lines, "bound"), axis=0))
    assert np.all(over < 2.0)


def test_ten_seconds_of_nothing_are_bridged_and_the_target_is_found_again() -> None:
    lines = lines_of("gap", frames=80)
    assert_consistent(lines)
    for line in lines:
        gap = line["gap"]
        beside, largest = np.array(gap["sigma"])
        assert largest[0] > 3.0 * beside[0] and np.all(largest > beside)
        # the larger sigma covers the larger error
        assert gap["inside"] > 0.95
        assert gap["behind"][0] < PLACED_M and gap["behind"][1] < PLACED_RAD
    # position, velocity, attitude, rate: three each, hardly more than three degrees of freedom a sequence
    assert np.all(np.mean([line["gap"]["nees"][:4] for line in lines], axis=0) < 3.0 * 2.7)


def test_jitter_with_poses_of_stated_noise_leaves_no_bias_beyond_sigma() -> None:
    lines = lines_of("jitter, reported poses")
    assert_consistent(lines)
    # the mean of three has a sigma smaller by the root of three
    assert np.abs(np.sqrt(3.0) * deviations(lines).mean(axis=0)).max() < 3.5


def test_relative_poses_that_contradict_one_another_do_not_spoil_the_whole() -> None:
    """A third of them wrong, beside outliers: the first motion lacks frames, the whole has none far off."""
    sequence = generate(replace(SCENE, outliers=0.2, wrong_pairs=0.35), 43)
    initial, estimate = run(sequence)
    assert not initial.connected.all()
    # landmarks that the first motion put far off are triangulated again
    assert np.mean(estimate.inlier_weight[~sequence.outlier] > 0.0) > 0.95
    assert np.mean(estimate.inlier_weight[sequence.outlier] > 0.0) < 0.05
    turn = np.swapaxes(sequence.X_NG[:, :3, :3], 1, 2) @ estimate.X_NG[:, :3, :3]
    assert np.rad2deg(np.linalg.norm(log_so3(turn[0].T @ turn), axis=1)).max() < 1.5
    error = np.array([estimate.mass.k1 - sequence.truth.k1, estimate.mass.k2 - sequence.truth.k2])
    assert np.all(np.abs(error) < 4.0 * np.sqrt(np.diag(estimate.mass.cov_k)))


@pytest.mark.parametrize("seed", [43, 45, 49])
def test_rounding_does_not_decide_where_a_contradicted_start_ends(seed: int) -> None:
    """Before bundle adjustment four frames of seed 43 are off by 100 degrees, with links that agree."""
    sequence = generate(replace(SCENE, outliers=0.2, wrong_pairs=0.35), seed)
    config = Backend(solver="gauss_newton", systematic_px=(0.0, 0.0, 0.0), light_px=0.0)
    first = initialize_motion(sequence.tracks, sequence.relative, config)
    shifted = replace(sequence.tracks, uvd_px=sequence.tracks.uvd_px * (1.0 + 1e-12))
    again = initialize_motion(shifted, sequence.relative, config)
    np.testing.assert_array_equal(again.connected, first.connected)
    np.testing.assert_allclose(again.X_RG, first.X_RG, atol=1e-6)
    # and nearly all frames of the map are close to their true attitude
    X_NG = sequence.tracks.X_NR @ first.X_RG
    turn = (np.swapaxes(sequence.X_NG[:, :3, :3], 1, 2) @ X_NG[:, :3, :3])[first.connected]
    middle = turn[len(turn) // 2]
    assert np.mean(np.rad2deg(np.linalg.norm(log_so3(middle.T @ turn), axis=1)) < 5.0) > 0.9


@pytest.mark.parametrize(("accel_psd", "torque_psd"), [(1e-8, 1e-7), (1e-5, 1e-6), (1e-7, 1e-5)])
def test_full_smoothing_recovers_the_level_of_the_disturbances(accel_psd: float, torque_psd: float) -> None:
    """From a stated 1e-6 of both. Each sequence within a decade, their mean within half of one."""
    off = []
    for seed in (20, 21):
        _, estimate = run(generate(replace(SCENE, accel_psd=accel_psd, torque_psd=torque_psd), seed))
        noise = estimate.noise
        off.append(np.log10([noise.accel_psd / accel_psd, noise.torque_psd / torque_psd]))
    assert np.abs(off).max() < 1.0
    assert np.abs(np.mean(off, axis=0)).max() <= 0.5


def test_the_jittering_inspector_keeps_to_its_band_and_to_what_it_states() -> None:
    jittery = replace(SCENE, deadband_m=(4e-3, 1e-3), deadband_rad=(0.007, 0.005))
    still, moving = generate(SCENE, 5), generate(jittery, 5)
    off = inverse_pose(still.X_NR) @ moving.X_NR
    assert 2e-3 < np.abs(off[:, :3, 3]).max() < 4.1e-3
    assert 0.004 < np.abs(log_so3(off[:, :3, :3])).max() < 0.0075
    np.testing.assert_array_equal(moving.tracks.X_NR, moving.X_NR)
    # the target is the same one
    np.testing.assert_array_equal(moving.X_NG, still.X_NG)
    noisy = generate(replace(jittery, sigma_camera_p_m=1e-3, sigma_camera_theta_rad=1e-3), 5)
    np.testing.assert_array_equal(noisy.X_NR, moving.X_NR)
    off = inverse_pose(noisy.X_NR) @ noisy.tracks.X_NR
    assert np.std(off[:, :3, 3]) == pytest.approx(1e-3, rel=0.2)
    assert np.std(log_so3(off[:, :3, :3])) == pytest.approx(1e-3, rel=0.2)
