"""Frames that contradict the others: first motions without them, and the motion that comes out."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.backend.fit import motions_from_fewer_frames
from polhode.config.backend import Backend
from polhode.lie import Array, exp_so3, inverse_pose, log_so3, make_pose
from polhode.progress import Silent
from polhode.records import Bools, InitialMotion, MotionEstimate, StereoTracks
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

GAP = range(26, 46)
SCENE = SyntheticScene(
    frames=70, landmarks=300, detection=0.5, w_G=(0.3, 0.45, 0.35), J_G=np.diag([1.5, 1.2, 0.9]),
    sigma_uv_px=0.3, sigma_d_px=0.3, accel_psd=1e-9, torque_psd=1e-9, dropped=tuple(GAP),
)  # fmt: skip
THIRD: Array = make_pose(exp_so3([0.0, 0.0, 2.0 * np.pi / 3.0]), np.zeros(3))


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
    poor = np.isin(tracks.frame, [2, 3, 50]) & (np.arange(len(tracks.frame)) % 10 > 0)
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
    np.testing.assert_array_equal(known[0], initial.connected & ~np.isin(frames, [2, 3, 50]))
    first, last = sorted(known[1:], key=lambda k: int(np.argmax(k)))
    np.testing.assert_array_equal(first, frames < GAP.start)
    np.testing.assert_array_equal(last, frames >= GAP.stop)
    # nothing to leave out where there is no gap and every frame is rich
    whole = replace(initial, connected=frames < GAP.start)
    assert motions_from_fewer_frames(tracks, whole) == []
