"""Mass properties that change at a push are named; a push alone, and a free tumble, are not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, make_pose, transform_points
from polhode.geometry.rigid_body import propagate
from polhode.pipeline.checks.data_checks.mass_check import mass_checks, part_of
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.verdict import reasons_of
from polhode.runtime.progress import Silent

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480)
FRAMES, DT_S, PUSH, LANDMARKS = 48, 0.5, 24, 100
BEFORE, AFTER = np.diag([1.5, 1.2, 0.9]), np.diag([1.5, 1.05, 1.0])
ZERO, PUSH_W = np.zeros(3), np.array([0.1, -0.05, 0.0])


def sequence(J: Array, com_G: Array, push_w: Array) -> tuple[StereoTracks, MotionEstimate]:
    """A tumble that is pushed in the middle, with other mass properties from then on; and its estimate."""
    rng = np.random.default_rng(5)

    def states(J: Array, com_G: Array, w: Array, R: Array, r_N: Array, v_N: Array, count: int) -> Any:
        """Poses X_NG (count, 4, 4), and the last state."""
        r, v, R_NP, w_P = propagate(DT_S * np.arange(count), r_N, v_N, R, w, J)
        return make_pose(R_NP, r - (R_NP @ com_G)), (r[-1], v[-1], R_NP[-1], w_P[-1])

    w, r = np.array([0.6, 0.5, 0.4]), np.array([0.05, 0.0, 0.6])
    first, (r, v, R, w) = states(BEFORE, ZERO, w, np.eye(3), r, ZERO, PUSH)
    second, _ = states(J, com_G, w + push_w, R, r + R @ com_G, v + np.array([2e-3, 0, 0]), FRAMES - PUSH + 1)
    X_NG = np.concatenate([first, second[1:]])
    p_G = rng.normal(size=(LANDMARKS, 3))
    p_G *= 0.1 / np.linalg.norm(p_G, axis=1, keepdims=True)
    rows = []
    for k in range(FRAMES):
        p_R = transform_points(X_NG[k], p_G)
        facing = np.einsum("na,na->n", p_R - X_NG[k][:3, 3], -p_R) > 0.01
        seen = np.flatnonzero(facing & (rng.random(LANDMARKS) < 0.7))
        noise = rng.normal(size=(len(seen), 3)) * [0.2, 0.2, 0.1]
        rows.append((np.full(len(seen), k), seen, RIG.project(p_R[seen]) + noise))
    frame, landmark, uvd_px = (np.concatenate(each) for each in zip(*rows, strict=True))
    stamps = np.round(DT_S * 1e9 * np.arange(FRAMES)).astype(np.int64)
    number, sigma_px = np.unique(landmark, return_inverse=True)[1], np.tile([0.3, 0.3, 0.1], (len(frame), 1))
    at_rest = np.tile(np.eye(4), (FRAMES, 1, 1))
    tracks = StereoTracks(RIG, stamps, at_rest, frame, number.astype(np.int64), uvd_px, sigma_px)
    start = InitialMotion(X_NG, np.ones(FRAMES, dtype=np.bool_))
    return tracks, estimate_motion(tracks, start, Backend(), Silent())


@pytest.mark.parametrize(("shift_m", "words"), [(0.008, "another point"), (0.0, "other mass properties")])
def test_a_part_that_leaves_or_moves_about_the_centre_is_named(shift_m: float, words: str) -> None:
    tracks, estimate = sequence(AFTER, np.array([shift_m, 0.0, 0.0]), PUSH_W)
    checks, unseen = mass_checks(tracks, estimate, Backend())
    (said,) = reasons_of(checks)
    assert not unseen and words in said
    assert shift_m == 0.0 or "from 12.0 s on" in said or "from 11.5 s on" in said


def test_a_push_alone_is_not_but_what_would_not_show_is_told() -> None:
    tracks, estimate = sequence(BEFORE, ZERO, PUSH_W)
    assert estimate.disturbances is not None
    checks = mass_checks(tracks, estimate, Backend())[0]
    assert reasons_of(checks) == [] and all(check.value is not None for check in checks)
    noise = replace(estimate.noise, pixel_sigma_px=6.0, disparity_sigma_px=2.0)
    checks, (told,) = mass_checks(tracks, replace(estimate, noise=noise), Backend())
    assert reasons_of(checks) == [] and "a centre of mass that moved by up to" in told
    assert 1.0 < float(told.split("up to ")[1].split(" mm")[0]) < 20.0


def test_a_free_tumble_costs_nothing_and_a_part_keeps_its_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    tracks, estimate = sequence(BEFORE, ZERO, ZERO)
    if estimate.disturbances is None:
        monkeypatch.setattr("polhode.pipeline.checks.data_checks.mass_check.estimate_motion", None)
    checks, unseen = mass_checks(tracks, estimate, Backend())
    assert reasons_of(checks) == unseen == []
    part = part_of(tracks, np.arange(FRAMES) >= 20)
    assert part.n_frames == 28 and part.frame.min() == 0 and len(np.unique(part.landmark)) == part.n_landmarks
    np.testing.assert_array_equal(part.uvd_px, tracks.uvd_px[tracks.frame >= 20])
