"""All frames of a long sequence from the estimate of its key frames."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.between_key_frames import FrameGuess, first_states, smooth_between
from polhode.backend.estimate import estimate_motion
from polhode.backend.initialization.multistart import KnownMotion
from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.backend.window import SlidingWindow, frames_of, online_estimate
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Ints, exp_so3, inverse_pose
from polhode.records.estimate import InitialMotion, MotionEstimate, OnlineEstimate
from polhode.records.tracks import StereoTracks
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import BOX, calibrated, deviations, with_errors

CONFIG = Backend.model_validate({"window": {"solver": "gauss_newton"}, "solver": "gauss_newton"})
SCENE = SyntheticScene(
    frames=160, landmarks=900, w_G=(3.0 * 0.1047, 6.0 * 0.1047, 2.0 * 0.1047), J_G=BOX, sigma_uv_px=0.5,
    sigma_d_px=0.5, v_N=(0.0, 0.0, 0.0), outliers=0.02, links=False,
)  # fmt: skip
KEYS: Ints = np.unique(np.concatenate([np.arange(0, 160, 4), [159]]))


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(SCENE, 5)


@pytest.fixture(scope="module")
def online(sequence: SyntheticSequence) -> OnlineEstimate:
    tracks = sequence.tracks
    window = SlidingWindow(tracks.rig, CONFIG)
    states = [window.add(each) for each in frames_of(tracks)]
    assert window.restarts == 0
    return online_estimate(states, tracks.rig, tracks.X_NR, CONFIG)


def part_of(tracks: StereoTracks, keys: Ints) -> StereoTracks:
    """The key frames alone."""
    rows = np.isin(tracks.frame, keys)
    return replace(
        tracks,
        timestamps_ns=tracks.timestamps_ns[keys],
        X_NR=tracks.X_NR[keys],
        frame=np.searchsorted(keys, tracks.frame[rows]),
        landmark=np.unique(tracks.landmark[rows], return_inverse=True)[1].reshape(-1).astype(np.int64),
        uvd_px=tracks.uvd_px[rows],
        sigma_px=tracks.sigma_px[rows],
    )


@pytest.fixture(scope="module")
def of_keys(sequence: SyntheticSequence, online: OnlineEstimate) -> MotionEstimate:
    part = part_of(sequence.tracks, KEYS)
    J_G = online.R_GP[-1] @ np.diag(np.exp([online.k[-1, 0], 0.0, -online.k[-1, 1]])) @ online.R_GP[-1].T
    w_G = np.einsum("fij,fj->fi", online.R_GP, online.w_P)[KEYS]
    known = KnownMotion(online.v_N[KEYS], w_G, online.com_G[-1], second_moments_from_inertia(J_G))
    initial = InitialMotion(inverse_pose(part.X_NR) @ online.X_NG[KEYS], np.ones(len(KEYS), dtype=np.bool_))
    return estimate_motion(part, initial, CONFIG, Silent(), known)


@pytest.fixture(scope="module")
def everywhere(
    sequence: SyntheticSequence, online: OnlineEstimate, of_keys: MotionEstimate
) -> tuple[StereoTracks, MotionEstimate]:
    guess = first_states(sequence.tracks, KEYS, of_keys, online, 0, CONFIG)
    return smooth_between(sequence.tracks, KEYS, of_keys, guess, CONFIG)


def test_every_frame_has_a_state_as_good_as_its_covariance_says_and_gross_errors_no_weight(
    sequence: SyntheticSequence, of_keys: MotionEstimate, everywhere: tuple[StereoTracks, MotionEstimate]
) -> None:
    truth, (part, found) = sequence.truth, everywhere
    assert len(found.r_N) == SCENE.frames
    keys, off = of_keys.r_N - truth.r_N[KEYS], found.r_N - truth.r_N
    assert np.sqrt(np.mean(off**2)) < 1.1 * np.sqrt(np.mean(keys**2))
    squared = np.einsum("fi,fij,fj->f", off, np.linalg.inv(found.covariance[:, :3, :3]), off)
    assert 0.5 < np.mean(squared) < 6.0
    assert len(part.frame) == len(found.inlier_weight) == len(found.residuals_px)
    refused = float(np.mean(found.inlier_weight == 0.0))
    assert 0.5 * SCENE.outliers < refused < 2.0 * SCENE.outliers


def test_a_worse_start_ends_in_the_same_states_and_frames_before_a_restart_are_located_in_the_map(
    sequence: SyntheticSequence,
    online: OnlineEstimate,
    of_keys: MotionEstimate,
    everywhere: tuple[StereoTracks, MotionEstimate],
) -> None:
    tracks, expected = sequence.tracks, everywhere[1]
    guess = first_states(tracks, KEYS, of_keys, online, 0, CONFIG)
    X_NG, rng = guess.X_NG.copy(), np.random.default_rng(1)
    X_NG[:, :3, 3] += rng.normal(0.0, 2e-3, (SCENE.frames, 3))
    X_NG[:, :3, :3] = X_NG[:, :3, :3] @ exp_so3(rng.normal(0.0, 0.02, (SCENE.frames, 3)))
    found = smooth_between(tracks, KEYS, of_keys, FrameGuess(X_NG, guess.v_N, guess.w_G), CONFIG)[1]
    sigma = np.sqrt(np.diagonal(expected.covariance, axis1=1, axis2=2)[:, :3])
    assert np.abs((found.r_N - expected.r_N) / sigma).max() < 0.05
    later, X_NG = KEYS[KEYS >= 20], online.X_NG.copy()
    X_NG[:20] = np.eye(4)
    names = [each for each in vars(of_keys) if np.shape(getattr(of_keys, each))[:1] == (len(KEYS),)]
    cut = replace(of_keys, **{name: getattr(of_keys, name)[KEYS >= 20] for name in names})
    kept = np.isin(tracks.frame[np.isin(tracks.frame, KEYS)], later)
    cut = replace(cut, residuals_px=of_keys.residuals_px[kept], inlier_weight=of_keys.inlier_weight[kept])
    guess = first_states(tracks, later, cut, replace(online, X_NG=X_NG), 20, CONFIG)
    found = smooth_between(tracks, later, cut, guess, CONFIG)[1]
    assert np.abs(found.r_N - expected.r_N)[:20].max() < 2e-3


def test_errors_of_the_calibration_count_as_in_the_batch_of_all_frames() -> None:
    scene = replace(
        SCENE, frames=48, landmarks=400, detection=0.4, sigma_uv_px=0.2, sigma_d_px=0.2, outliers=0.0
    )
    given = CONFIG.model_copy(update={"process_noise": "given"})
    sequence = with_errors(calibrated(generate(scene, 3)), 3)[0]
    tracks, truth, keys = sequence.tracks, sequence.truth, np.arange(0, 48, 3)
    w_G = truth.w_P @ truth.R_GP.T
    second = second_moments_from_inertia(truth.R_GP * truth.moments @ truth.R_GP.T)
    X_RG = inverse_pose(tracks.X_NR) @ sequence.X_NG

    def solved(part: StereoTracks, frames: Ints) -> MotionEstimate:
        known = KnownMotion(truth.v_N[frames], w_G[frames], truth.com_G, second)
        initial = InitialMotion(X_RG[frames], np.ones(len(frames), dtype=np.bool_))
        return estimate_motion(part, initial, given, Silent(), known)

    whole, of_keys = solved(tracks, np.arange(48)), solved(part_of(tracks, keys), keys)
    guess = FrameGuess(sequence.X_NG, truth.v_N, w_G)
    found = smooth_between(tracks, keys, of_keys, guess, given)[1]
    assert whole.calibration is not None and found.calibration is not None
    ours, theirs = (np.diag(part.last_joint)[:12] for part in (found.calibration, whole.calibration))
    np.testing.assert_allclose(ours[:3], theirs[:3], rtol=0.15)
    assert theirs[2] > 0.1 * whole.covariance[-1][2, 2]
    # of velocity, attitude and rate the images' part is the larger one by far
    assert (np.abs(ours - theirs)[3:] < 0.03 * np.diag(whole.covariance[-1])[3:]).all()
    assert np.abs(deviations(sequence, found)).max() < 5.0
