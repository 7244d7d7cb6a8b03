"""A rig that is not the calibrated one: each fault is named, with its size; a good one is not."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.frontend.features.epipolar_search import RowOffsets
from polhode.geometry.lie import Array
from polhode.pipeline.checks.data_checks.rig_check import (
    RowSpeeds,
    camera_delay,
    delay_by_rows,
    largest_step,
    rig_checks,
)
from polhode.pipeline.checks.data_checks.self_calibration import best_stretches, focal_check
from polhode.records.estimate import CalibrationScore, InitialMotion, MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.verdict import reasons_of
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import calibrated

FRAMES = 24
SCENE = SyntheticScene(
    frames=FRAMES, landmarks=150, detection=0.7, sigma_uv_px=0.3, sigma_d_px=0.1,
    J_G=np.diag([1.5, 1.2, 0.9]), w_G=(0.3, 0.5, 0.3),
)  # fmt: skip


def solved(sequence: SyntheticSequence, tracks: StereoTracks) -> MotionEstimate:
    """From the true poses."""
    X_RG = np.linalg.inv(sequence.tracks.X_NR) @ sequence.X_NG
    start = InitialMotion(X_RG, np.ones(tracks.n_frames, dtype=np.bool_))
    return estimate_motion(tracks, start, Backend(), Silent())


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(SCENE, 3)


@pytest.fixture(scope="module")
def estimate(sequence: SyntheticSequence) -> MotionEstimate:
    return solved(sequence, sequence.tracks)


def features(tracks: StereoTracks, offset_px: Any = 0.0, exchanged: tuple[int, ...] = ()) -> list[Any]:
    """Rows of each frame; offset_px (M,) of the observations."""
    rng, out = np.random.default_rng(4), []
    offset_px = offset_px + 0.2 * rng.standard_normal(len(tracks.frame))
    for k in range(tracks.n_frames):
        rows = np.flatnonzero(tracks.frame == k)
        uvd, sign = tracks.uvd_px[rows], -1.0 if k in exchanged else 1.0
        out.append(SimpleNamespace(rows=RowOffsets(uvd[:, :2], sign * uvd[:, 2], offset_px[rows])))
    return out


def reasons(
    tracks: StereoTracks, estimate: MotionEstimate, seen: list[Any], ranges: bool = False
) -> list[str]:
    context: Any = SimpleNamespace(
        rig=tracks.rig, time_s=tracks.time_s, X_NR=tracks.X_NR, sequence=SimpleNamespace(has_ranges=ranges)
    )
    return reasons_of(rig_checks(context, seen, tracks, estimate))


def test_a_good_rig_passes_and_knocks_and_exchanged_images_are_named(
    sequence: SyntheticSequence, estimate: MotionEstimate
) -> None:
    tracks = sequence.tracks
    seen, rig = features(tracks), tracks.rig
    assert reasons(tracks, estimate, seen) == []
    assert reasons(tracks, estimate, [SimpleNamespace(rows=None) for _ in seen]) == []
    later, angle = tracks.frame >= 10, np.deg2rad(0.2)
    (up,) = reasons(tracks, estimate, features(tracks, angle * rig.focal_px * later))
    assert "as if one camera had turned by 0.20 deg" in up and f"from {tracks.time_s[10]:g} s" in up
    rolled = features(tracks, angle * (tracks.uvd_px[:, 0] - rig.cx_px) * later)
    roll = reasons(tracks, estimate, rolled)[-1]
    assert "deg more from 5 s on, as if one camera had turned about its axis" in roll
    (exchanged,) = reasons(tracks, estimate, features(tracks, exchanged=(2, 9)))
    assert f"2 of {FRAMES} pairs are exchanged, left for right" in exchanged


def test_cameras_that_look_at_different_times_are_named_with_the_time(
    sequence: SyntheticSequence, estimate: MotionEstimate
) -> None:
    tracks = sequence.tracks
    p_R, k = tracks.rig.triangulate(tracks.uvd_px), tracks.frame
    p_N = np.einsum("nij,nj->ni", tracks.X_NR[k][:, :3, :3], p_R) + tracks.X_NR[k][:, :3, 3]
    w_N = np.einsum("nij,nj->ni", estimate.R_NP, estimate.w_P)
    v_N = estimate.v_N[k] + np.cross(w_N[k], p_N - estimate.r_N[k])
    v_R = np.einsum("nji,nj->ni", tracks.X_NR[k][:, :3, :3], v_N)
    rows_px_s = tracks.rig.focal_px * (v_R[:, 1] - v_R[:, 2] * p_R[:, 1] / p_R[:, 2]) / p_R[:, 2]
    seen = features(tracks, -0.020 * rows_px_s)
    context: Any = SimpleNamespace(rig=tracks.rig, time_s=tracks.time_s, X_NR=tracks.X_NR)
    found = camera_delay(context, [each.rows for each in seen], estimate)
    assert found is not None and found.seconds == pytest.approx(0.020, abs=0.002)
    (said,) = reasons(tracks, estimate, seen)
    assert "the right camera's images are" in said and "ms late" in said


def test_rows_that_an_imperfect_calibration_inclines_are_no_delay() -> None:
    # As in photographs of an object on a turntable: at each place of the image the speed is always the same.
    spinning = generate(replace(SCENE, w_G=(0.0, 0.0, 0.4)), 4)
    tracks, estimate = spinning.tracks, solved(spinning, spinning.tracks)
    u, v, _ = ((tracks.uvd_px - tracks.uvd_px.mean(axis=0)) / tracks.uvd_px.std(axis=0)).T
    said = reasons(tracks, estimate, features(tracks, 0.2 * u - 0.1 * v + 0.1 * u * v))
    assert not any("ms late" in each or "ms early" in each for each in said)


def test_a_delay_that_hardly_displaces_the_rows_is_not_named() -> None:
    """At little speed a feature's inaccuracy would be a delay of hundreds of milliseconds."""
    rng, n = np.random.default_rng(5), 4000
    uvd, frame = rng.uniform(0.0, 100.0, size=(n, 3)), np.arange(n) // 100
    speed = 0.06 * rng.normal(size=n)
    for factor in (1.0, 10.0):
        offset = -0.3 * factor * speed + 0.01 * rng.normal(size=n)
        found = delay_by_rows([RowSpeeds(factor * speed, offset, frame, uvd)])
        assert found is not None and found.seconds == pytest.approx(0.3, abs=0.03) and found.sigma_s < 0.03
        assert (found.seconds > found.limit_s) == (factor > 1.0)


@pytest.mark.parametrize("knocked", [True, False])
def test_disparities_that_step_or_drift_are_named(sequence: SyntheticSequence, knocked: bool) -> None:
    tracks, uvd = sequence.tracks, sequence.tracks.uvd_px.copy()
    step = np.deg2rad(0.2) * tracks.rig.focal_px * (tracks.frame >= 12)
    uvd[:, 2] += step if knocked else 2.0 * tracks.frame / FRAMES
    wrong = replace(tracks, uvd_px=uvd)
    estimate, seen = solved(sequence, wrong), features(tracks)
    (said,) = reasons(wrong, estimate, seen)
    assert "all disparities are +" in said
    if knocked:
        assert "from 6 s on all disparities are +1." in said
        assert "turned sideways by 0.1" in said or "turned sideways by 0.2" in said
    # ranges that change are not two cameras that turn
    assert reasons(wrong, estimate, seen, ranges=True) == []


def test_steps_need_frames_on_both_sides_clear_values_and_count_by_sigmas() -> None:
    def step(values: Array, sigma: Array) -> Any:
        return largest_step(values, sigma)

    late = np.where(np.arange(20) < 18, 0.0, 5.0)
    assert step(late, np.ones(20)).size == 0.0 and step(np.full(20, np.nan), np.ones(20)) is None
    # inclinations of the rows [deg] that an upper stage with few features gave, undisturbed
    quiet, sigma = np.tile([-0.05, 0.05, 0.1, -0.1, 0.0], 6), np.full(35, 0.05)
    loose = step(np.concatenate([quiet, [5.6, 0.45, 2.6, 0.5, 0.15]]), sigma)
    firm = step(np.concatenate([quiet, [0.55, 0.45, 0.6, 0.5, 0.4]]), sigma)
    assert loose.place == firm.place == 30
    assert abs(loose.size) < 3.0 * loose.sigma and abs(firm.size) > 5.0 * firm.sigma
    sigma = np.where(np.arange(40) % 4 == 0, 0.1, 2.0)
    values = sigma * np.random.default_rng(4).normal(size=40) + np.where(np.arange(40) < 20, 0.0, 0.6)
    known, blind = step(values, sigma), step(values, np.full(40, float(np.median(sigma))))
    assert abs(known.size - 0.6) < 4.0 * known.sigma and abs(known.size) > 5.0 * known.sigma
    assert abs(blind.size) < 4.0 * blind.sigma


def test_successive_frames_that_are_alike_make_no_step() -> None:
    """A first-order autoregressive process of unit variance, as of landmarks that stay for many frames."""
    sigmas, alike = [], 0.8
    for seed in range(60):
        values = np.random.default_rng(seed).normal(size=40)
        for k in range(1, 40):
            values[k] = alike * values[k - 1] + np.sqrt(1.0 - alike**2) * values[k]
        found = largest_step(values, np.ones(40))
        assert found is not None
        sigmas.append(abs(found.size) / found.sigma)
    assert max(sigmas) < 5.0


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_a_wrong_focal_length_is_named_with_its_size(sequence: SyntheticSequence, factor: float) -> None:
    rig = sequence.tracks.rig
    wrong = replace(sequence.tracks, rig=replace(rig, focal_px=factor * rig.focal_px))
    known = calibrated(replace(sequence, tracks=wrong)).tracks
    found = solved(sequence, known)
    score = found.calibration_score
    assert score is not None
    focal = best_stretches(score)[0][0]
    assert focal == pytest.approx(1.0 / factor - 1.0, abs=0.008)
    (said,) = reasons_of([focal_check(found, has_ranges=False)])
    assert f"{'longer' if factor < 1 else 'shorter'} than calibrated" in said
    # with sigmas of the calibration that are that large, the data agree with it
    by_stated = []
    for times in (1.0, 10.0, 100.0):
        by = np.append(np.ones(2), np.full(len(score.score) - 2, times))
        vague = CalibrationScore(
            score.information * np.outer(by, by), score.score * by, score.noise * np.outer(by, by)
        )
        by_stated.append(focal_check(replace(found, calibration_score=vague), False).value or np.inf)
    assert by_stated[0] > by_stated[1] > by_stated[2] and by_stated[2] < 1.0
