"""Clock, inspector and landmarks that contradict the motion are named; what only looks like it is not."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.geometry.rigid_body import propagate
from polhode.pipeline.checks.data_checks.pose_checks import (
    clock_check,
    connection_check,
    inspector_check,
    swing_check,
)
from polhode.records.estimate import InitialMotion
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.summary_schema import Check
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, generate, random_scene

J = np.diag([1.5, 1.2, 0.9])
TIME_S: Array = np.linspace(0.0, 14.5, 30)
SEEN = np.ones(30, dtype=np.bool_)
FRAMES, PLACE, MIN_LANDMARKS = 20, 9, 6


def attitudes(time_s: Array, w: tuple[float, float, float] = (0.8, 0.2, 0.2)) -> Array:
    return np.asarray(propagate(time_s, np.zeros(3), np.zeros(3), np.eye(3), np.array(w), J)[2])


@pytest.mark.parametrize("jump_s", [0.8, 0.1, -0.3])
def test_a_jump_of_the_clock_is_named_with_the_times(jump_s: float) -> None:
    jumped = TIME_S + jump_s * (np.arange(30) >= 12)
    reason = clock_check(jumped, attitudes(TIME_S), SEEN).reason
    assert "most after 5.5 s" in reason and f"within the {0.5 + jump_s:.2f} s" in reason
    assert "in 0.50 s" in reason
    # a target at rest and frames without observations say nothing of the clock
    assert clock_check(jumped, np.tile(np.eye(3), (30, 1, 1)), SEEN).value is None
    assert clock_check(jumped, attitudes(TIME_S), ~SEEN).value is None


def test_missing_frames_uneven_intervals_and_a_torque_are_no_jumps() -> None:
    uneven = np.cumsum(np.random.default_rng(1).uniform(0.3, 0.7, 30))
    for time_s in (TIME_S[np.random.default_rng(0).random(30) < 0.7], uneven):
        assert clock_check(time_s, attitudes(time_s), SEEN[: len(time_s)]).reason == ""
    before = attitudes(TIME_S[:15])
    after = before[-1] @ attitudes(TIME_S[:16], (0.7, 0.3, 0.3))[1:]
    pushed = clock_check(TIME_S, np.concatenate([before, after]), SEEN)
    assert pushed.value is not None and pushed.reason == ""


@pytest.mark.parametrize(
    ("error_deg", "stated_deg", "moves"),
    [(1.0, 0.02, True), (0.0, 0.02, True), (0.0, 0.2, True), (0.0, 0.02, False)],
)
def test_poses_of_which_half_are_wrong_are_named_and_those_that_scatter_as_stated_are_not(
    error_deg: float, stated_deg: float, moves: bool
) -> None:
    """Of a camera that swings, or is at rest; its attitudes are off by so much in half of the frames."""
    rng, time_s = np.random.default_rng(2), np.linspace(0.0, 19.5, 40)
    swing = np.stack([0.02 * np.sin(0.7 * time_s), 0.03 * np.cos(0.5 * time_s), 0.0 * time_s], axis=1)
    true = make_pose(exp_so3(swing if moves else 0.0 * swing), np.zeros((40, 3)))
    axis = rng.standard_normal((40, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    wrong = np.deg2rad(error_deg) * axis * (rng.random(40) < 0.5)[:, None]
    noise = np.deg2rad(stated_deg) * rng.standard_normal((40, 3)) if moves else np.zeros((40, 3))
    reported = true @ make_pose(exp_so3(wrong + noise), np.zeros((40, 3)))
    target = make_pose(attitudes(time_s, (0.5, 0.2, 0.2)), np.tile([0.0, 0.0, 0.6], (40, 1)))
    X_NG = reported @ inverse_pose(true) @ target
    check = inspector_check(reported, X_NG, np.ones(40, dtype=np.bool_), float(np.deg2rad(stated_deg)))
    assert ("contradict the images" in check.reason) == (error_deg > 0.0)
    assert (check.value is None) == (not moves)


@pytest.mark.parametrize(
    ("deg", "at_rest"), [(1.0, True), (1.0, False), (0.0, True)], ids=["claims rest", "reports one", "none"]
)
def test_a_swing_of_the_inspector_is_named(deg: float, at_rest: bool) -> None:
    """Of one that swings by this while it reports to be at rest, or the reverse."""
    noise = {"sigma_uv_px": 0.3, "sigma_d_px": 0.1, "accel_psd": 1e-8, "torque_psd": 1e-8}
    sequence = generate(random_scene(4, frames=24, landmarks=120, detection=0.4, **noise), 4)
    tracks, X_NR, k = sequence.tracks, sequence.X_NR.copy(), np.arange(24.0)
    swing = exp_so3(np.deg2rad(deg) * np.stack([np.sin(k / 4.0), np.cos(k / 6.0), 0.0 * k], axis=1))
    X_RG = inverse_pose(X_NR) @ sequence.X_NG
    if at_rest:
        # what the swinging camera sees
        p_R = tracks.rig.triangulate(tracks.uvd_px)
        seen = np.einsum("nij,nj->ni", swing[tracks.frame], p_R)
        tracks = replace(tracks, uvd_px=tracks.uvd_px + tracks.rig.project(seen) - tracks.rig.project(p_R))
        X_RG[:, :3] = swing @ X_RG[:, :3]
    else:
        X_NR[:, :3, :3] = swing @ X_NR[:, :3, :3]
        tracks = replace(tracks, X_NR=X_NR)
    start = InitialMotion(X_RG, np.ones(24, dtype=np.bool_))
    check = swing_check(tracks, estimate_motion(tracks, start, Backend(), Silent()), Backend())
    assert check.value is not None and (check.value > 6.0 if deg else check.value < 3.0)
    named = [words in check.reason for words in ("check inspector0/", "deg beside what is reported")]
    assert named == [deg > 0] * 2


@pytest.fixture(scope="module")
def tracks() -> StereoTracks:
    return generate(SyntheticScene(frames=FRAMES, landmarks=60, detection=0.9), 0).tracks


def connection_of(
    tracks: StereoTracks, place: int, kept: int, frames: int = FRAMES, link_deg: float | None = None
) -> Check:
    """Of the first frames; after frame ``place`` other landmarks are seen, but for ``kept`` of them.

    link_deg: difference from the motion of a link of nine matches across it; None: there is no link.
    """
    sides = (tracks.frame <= place, tracks.frame > place)
    common = np.intersect1d(tracks.landmark[sides[0]], tracks.landmark[sides[1]])[kept:]
    other = sides[1] & np.isin(tracks.landmark, common)
    number = np.where(other, tracks.landmark + tracks.n_landmarks, tracks.landmark)
    rows = tracks.frame < frames
    landmark = np.unique(number[rows], return_inverse=True)[1].astype(np.int64)
    parts = {name: getattr(tracks, name)[rows] for name in ("frame", "uvd_px", "sigma_px")}
    estimate: Any = SimpleNamespace(inlier_weight=np.ones(len(landmark)), X_NG=tracks.X_NR)
    links = None
    if link_deg is not None:
        # in the cameras the target is at rest
        off = make_pose(exp_so3(np.deg2rad([[0.0, link_deg, 0.0]])), np.zeros((1, 3)))
        links = RelativePoses(np.array([place]), np.array([place + 1]), off, np.array([9]))
    return connection_check(replace(tracks, landmark=landmark, **parts), estimate, links)


@pytest.mark.parametrize("kept", [0, MIN_LANDMARKS - 1])
def test_parts_that_share_few_landmarks_are_reported(tracks: StereoTracks, kept: int) -> None:
    start, end = (tracks.time_s[k] for k in (PLACE, PLACE + 1))
    words = f"before {start:g} s and after {end:g} s share {kept or 'no'} landmarks"
    assert words in connection_of(tracks, PLACE, kept).reason
    assert words in connection_of(tracks, PLACE, kept, link_deg=6.0).reason
    assert connection_of(tracks, PLACE, kept, link_deg=4.0).reason == ""


@pytest.mark.parametrize(
    ("place", "kept", "frames"),
    [(FRAMES, 0, FRAMES), (PLACE, MIN_LANDMARKS, FRAMES), (FRAMES - 2, 0, FRAMES), (0, 0, FRAMES), (1, 0, 3)],
)
def test_a_whole_sequence_a_weak_end_and_a_few_frames_are_not(
    tracks: StereoTracks, place: int, kept: int, frames: int
) -> None:
    assert connection_of(tracks, place, kept, frames).reason == ""
