"""Checks of a solved sequence without images: an undisturbed one passes, each fault shows where it should."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.backend.subset_solution import estimate_part
from polhode.config.backend_settings import Backend
from polhode.geometry.camera import stereo_jacobian
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose, transform_points
from polhode.pipeline.checks.answer_checks import check_answer as module
from polhode.pipeline.checks.answer_checks.check_answer import (
    link_check,
    mirror_check,
    runner_up_check,
    window_check,
)
from polhode.pipeline.checks.answer_checks.part_solutions import (
    disagreements,
    largest,
    outline_and_interior,
    part_checks,
)
from polhode.pipeline.checks.answer_checks.residual_checks import (
    Residuals,
    means_in_errors,
    residual_checks,
    step_check,
    sun_check,
)
from polhode.records.estimate import InitialMotion, MotionEstimate, OnlineEstimate
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.summary_schema import Check
from polhode.run_directory.verdict import reasons_of
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

SCENE = SyntheticScene(
    frames=24, landmarks=400, detection=0.5, sigma_uv_px=0.3, sigma_d_px=0.2, accel_psd=1e-9, torque_psd=1e-9
)
SUN_N = np.array([0.6, -0.4, -0.7]) / np.linalg.norm([0.6, -0.4, -0.7])
CONFIG = Backend()
Solved = tuple[StereoTracks, MotionEstimate]


def solved(tracks: StereoTracks, sequence: SyntheticSequence) -> Solved:
    start = InitialMotion(inverse_pose(sequence.X_NR) @ sequence.X_NG, np.ones(SCENE.frames, dtype=np.bool_))
    return tracks, estimate_motion(tracks, start, CONFIG, Silent())


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(SCENE, 1)


@pytest.fixture(scope="module")
def undisturbed(sequence: SyntheticSequence) -> Solved:
    return solved(sequence.tracks, sequence)


def changed(sequence: SyntheticSequence, change: Callable[[Array, Array], Array]) -> Solved:
    """Points (M, 3) in the camera are moved by ``change`` of their Jacobian (M, 3, 3) and pose (M, 4, 4)."""
    tracks = sequence.tracks
    X_RG = (inverse_pose(tracks.X_NR) @ sequence.X_NG)[tracks.frame]
    p_R = transform_points(X_RG, sequence.p_G[tracks.landmark][:, None])[:, 0]
    J = stereo_jacobian(p_R, tracks.rig.focal_px, tracks.rig.baseline_m)
    return solved(replace(tracks, uvd_px=tracks.uvd_px + change(J, X_RG)), sequence)


def of_name(checks: list[Check], words: str) -> Check:
    (found,) = [check for check in checks if words in check.name]
    return found


def test_an_undisturbed_sequence_passes_all(undisturbed: Solved) -> None:
    tracks, estimate = undisturbed
    runner_up = runner_up_check(estimate)
    checks = [
        *part_checks(tracks, estimate, CONFIG),
        *residual_checks(tracks, estimate),
        sun_check(tracks, estimate, SUN_N),
        mirror_check(tracks, estimate),
    ]
    assert reasons_of([*checks, runner_up]) == [] and runner_up.limit is None
    assert all(check.value is not None and check.value >= 0.0 for check in checks)
    # a flat relief has a near mirror twin
    near = replace(estimate, noise=replace(estimate.noise, disparity_sigma_px=50.0))
    assert "inside out" in mirror_check(tracks, near).reason


def test_the_part_that_is_everything_is_the_estimate(undisturbed: Solved) -> None:
    tracks, estimate = undisturbed
    every, frames = np.ones(len(tracks.frame), dtype=np.bool_), np.arange(tracks.n_frames)
    again = estimate_part(tracks, estimate, CONFIG, every, frames)
    assert again is not None
    found = disagreements(again, estimate, frames, contained=False)
    assert {each.quantity for each in found} >= {"position", "velocity", "rotation", "rate"}
    assert all(each.sigmas < 0.05 for each in found)
    assert estimate_part(tracks, estimate, CONFIG, ~every, frames) is None


def test_the_largest_disagreement_is_in_sigmas_of_the_difference(undisturbed: Solved) -> None:
    estimate = undisturbed[1]
    sigma = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2)[:, :3])
    b = replace(estimate, covariance=estimate.covariance * np.eye(12))
    a = replace(b, r_N=estimate.r_N + 4.0 * sigma)
    for contained, expected in ((False, 4.0 / np.sqrt(2.0)), (True, 4.0)):
        found = largest(disagreements(a, b, np.arange(len(sigma)), contained))
        assert found is not None and found.quantity == "position"
        assert found.sigmas == pytest.approx(expected)
    assert largest(found=[]) is None


def test_outline_and_interior_share_the_landmarks(undisturbed: Solved) -> None:
    tracks, estimate = undisturbed
    outer, inner = outline_and_interior(tracks, estimate)
    assert not np.any(outer & inner) and not set(tracks.landmark[outer]) & set(tracks.landmark[inner])
    uv = tracks.uvd_px[:, :2]
    centre = np.stack([uv[tracks.frame == k].mean(axis=0) for k in range(tracks.n_frames)])[tracks.frame]
    distance = np.linalg.norm(uv - centre, axis=1)
    assert distance[outer].mean() > 1.2 * distance[inner].mean()


def test_a_camera_that_is_late_shows_over_image_and_depth(sequence: SyntheticSequence) -> None:
    w_N, k = sequence.X_NG[:, :3, :3] @ np.array(SCENE.w_G), sequence.tracks.frame

    def late(J: Array, X_RG: Array) -> Array:
        own_R = np.einsum("nij,nj->ni", X_RG[:, :3, :3], sequence.p_G[sequence.tracks.landmark])
        v_R = np.cross(np.einsum("nji,nj->ni", sequence.X_NR[k][:, :3, :3], w_N[k]), own_R)
        moved = np.einsum("nij,nj->ni", J, v_R)
        return np.stack([0.0 * k, 0.0 * k, -0.02 * (moved[:, 0] - moved[:, 2])], axis=1)

    checks = residual_checks(*changed(sequence, late))
    assert of_name(checks, "disparity per region").reason
    assert "calibration" in of_name(checks, "residuals with the disparity").reason


def test_a_step_of_the_disparities_is_told_from_a_line_and_from_noise() -> None:
    rng = np.random.default_rng(0)
    frame = np.repeat(np.arange(40), 50)
    landmark, uvd_px, noise = np.arange(2000), np.ones((2000, 3)), rng.normal(size=(2000, 3))

    def checked(mean: Array) -> tuple[float, str]:
        check = step_check(Residuals(frame, landmark, uvd_px, noise + mean[frame, None]))
        assert check.value is not None
        return check.value, check.reason

    t = np.arange(40.0)
    drift, reason = checked(0.05 * t - 1.0)
    assert not reason and 0.5 < drift < 3.0
    step, reason = checked(0.05 * t - 1.0 + 0.5 * (t >= 20))
    # the standard error of a step in the middle beside a line: four over the root of the number of values
    assert step == pytest.approx(0.5 / (4.0 / np.sqrt(2000)), abs=2.0)
    assert any(f"about frame {k}" in reason for k in (19, 20, 21))
    # of frames that scatter by more than their values do, a step must be larger
    assert checked(0.5 * (t >= 20) + 0.5 * rng.normal(size=40))[0] < 0.5 * step
    assert step_check(Residuals(frame[:300], landmark[:300], uvd_px[:300], noise[:300])).value is None


def test_a_mean_is_as_uncertain_as_the_landmarks_that_it_is_made_of() -> None:
    rng = np.random.default_rng(0)
    landmark = np.repeat(np.arange(2000), 8)
    group = landmark % 20
    alike = np.repeat(rng.normal(size=(2000, 2)), 8, axis=0)
    for values in (alike, rng.normal(size=(16000, 2))):
        means = means_in_errors(values, group, landmark, 30)
        assert means.shape == (20, 2)
        assert 0.7 < np.sqrt(np.mean(means**2)) < 1.3
    # a mean that all landmarks have in common stands out all the same
    assert np.sqrt(np.mean(means_in_errors(alike + 1.0, group, landmark, 30) ** 2)) > 5.0


def test_landmarks_that_slide_with_the_sun_are_found(sequence: SyntheticSequence) -> None:
    def slide(J: Array, X_RG: Array) -> Array:
        R_NG = sequence.X_NG[sequence.tracks.frame, :3, :3]
        p_G = sequence.p_G[sequence.tracks.landmark]
        normal = p_G / np.linalg.norm(p_G, axis=1, keepdims=True)
        sun_G = np.einsum("nji,j->ni", R_NG, SUN_N)
        along = sun_G - np.sum(sun_G * normal, axis=1, keepdims=True) * normal
        return np.asarray(np.einsum("nij,njk,nk->ni", J, X_RG[:, :3, :3], 3e-3 * along))

    case = changed(sequence, slide)
    assert "slide over the surface" in sun_check(*case, SUN_N).reason
    assert sun_check(*case, None).value is None


def test_a_motion_that_is_less_free_than_stated_breaks_its_prediction() -> None:
    sequence = generate(replace(SCENE, accel_psd=1e-5), 2)
    tracks, estimate = solved(sequence.tracks, sequence)
    words = "prediction from the first"
    assert of_name(part_checks(tracks, estimate, CONFIG), words).reason == ""
    stiff = replace(estimate, noise=replace(estimate.noise, accel_psd=1e-10))
    assert "predicts another" in of_name(part_checks(tracks, stiff, CONFIG), words).reason


def test_links_that_contradict_the_motion_are_counted(sequence: SyntheticSequence) -> None:
    X_RG = inverse_pose(sequence.X_NR) @ sequence.X_NG
    assert link_check(sequence.relative, X_RG).value == 0.0
    turns = make_pose(exp_so3(np.outer(np.arange(len(X_RG)), [0.0, 0.0, 0.2])), np.zeros((len(X_RG), 3)))
    check = link_check(sequence.relative, X_RG @ turns)
    assert check.value == pytest.approx(100.0) and "100% of the links" in check.reason
    few = RelativePoses(*(values[:5] for values in vars(sequence.relative).values()))
    assert link_check(few, X_RG).value is None


def test_a_check_that_ends_with_an_error_is_a_reason_for_doubt(
    undisturbed: Solved, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*given: object) -> list[Check]:
        raise ValueError("seven is not a pose")

    monkeypatch.setattr(module, "residual_checks", fails)
    none = np.zeros(0, dtype=np.int64)
    links = RelativePoses(none, none, np.zeros((0, 4, 4)), none)
    checks = module.check_answer(*undisturbed, links, CONFIG, None, None)
    (reason,) = reasons_of(checks)
    assert "seven is not a pose" in reason
    # the others were made all the same
    assert of_name(checks, "halves of the landmarks").value is not None


def test_the_causal_estimate_ends_within_the_larger_sigma_of_the_smoothed_one(undisturbed: Solved) -> None:
    _, estimate = undisturbed
    frames, sigma = len(estimate.r_N), np.sqrt(np.diagonal(estimate.covariance[-1]))

    def online(share: float, sigmas: float) -> OnlineEstimate:
        """Covariance times ``share``; the last position along x off by ``sigmas`` of the smoothed one."""
        r_N = estimate.r_N.copy()
        r_N[-1, 0] += sigmas * sigma[0]
        eye, zero = np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 3))
        states = (r_N, estimate.v_N, estimate.R_NP, estimate.w_P, share * estimate.covariance)
        k, known = (zero[:, :2], eye[:, :2, :2]), np.ones((frames, 4), dtype=np.bool_)
        mass, frame = (zero, eye, eye, eye), np.zeros(frames, dtype=np.int64)
        return OnlineEstimate(estimate.timestamps_ns, *states, estimate.X_NG, *k, *mass, known, frame)

    assert window_check(None, estimate).value is None
    # a causal estimate that takes itself for surer than the smoothed one does not count as such
    assert window_check(online(0.01, 2.0), estimate).value == pytest.approx(2.0)
    assert window_check(online(4.0, 2.0), estimate).value == pytest.approx(1.0)
    assert "5.0 sigma away" in window_check(online(1.0, 5.0), estimate).reason
