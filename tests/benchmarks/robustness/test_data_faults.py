"""The campaign of faults: each change does what its title says, and the judge counts what it should."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.robustness import faults_of_files as files
from benchmarks.robustness.bodies import BODIES, scene_of
from benchmarks.robustness.data_faults import FAULTS
from benchmarks.robustness.judge import OUTCOMES, Claim, entry_of, outcome_of
from benchmarks.robustness.recording import Recording
from polhode.records import Truth

F = 40


@pytest.fixture
def recording() -> Recording:
    rng = np.random.default_rng(0)
    images = rng.integers(20, 120, (2, F, 24, 32)).astype(np.uint8)
    stamps_ns = np.int64(10**18) + 500_000_000 * np.arange(F, dtype=np.int64)
    eye = np.tile(np.eye(3), (F, 1, 1))
    away = np.tile([0.0, 0.0, 0.6], (F, 1))
    truth = Truth(
        stamps_ns, away, eye, 0.0 * away, 0.0 * away, np.ones(3), 0.1, 0.2, np.zeros(3), np.eye(3), None
    )
    return Recording(images[0], images[1], stamps_ns, truth, focal_px=40.0, baseline_m=0.09)


def changed(name: str, recording: Recording) -> Recording:
    change = FAULTS[name].change
    assert change is not None
    return change(recording, np.random.default_rng(1))


def test_the_campaign_has_three_hundred_runs_over_twelve_bodies() -> None:
    assert len(BODIES) >= 12
    assert len(BODIES) * len(FAULTS) >= 300
    for name in BODIES:
        scene, _ = scene_of(name)
        assert scene.frames == F


@pytest.mark.parametrize(("name", "left"), [("dropped_10", 36), ("dropped_30", 28), ("dropped_60", 16)])
def test_dropped_frames_leave_the_first_and_the_last(recording: Recording, name: str, left: int) -> None:
    out = changed(name, recording)
    assert len(out) == len(out.truth.r_N) == left
    assert out.stamps_ns[0] == recording.stamps_ns[0] and out.stamps_ns[-1] == recording.stamps_ns[-1]


def test_ten_seconds_are_lost_at_once(recording: Recording) -> None:
    gap_s = np.diff(changed("burst", recording).stamps_ns).max() * 1e-9
    assert 10.0 <= gap_s <= 11.0


def test_one_camera_is_dark_for_five_seconds(recording: Recording) -> None:
    out = changed("dead_camera", recording)
    dark = [np.sum(images.reshape(F, -1).mean(axis=1) < 5.0) for images in (out.left, out.right)]
    assert sorted(dark) == [0, 10]


def test_exchanged_sides_and_order_keep_every_image(recording: Recording) -> None:
    sides, order = changed("sides_exchanged", recording), changed("order_exchanged", recording)
    exchanged = np.array([np.array_equal(sides.left[k], recording.right[k]) for k in range(F)])
    assert exchanged.sum() == 8
    moved = [k for k in range(F) if not np.array_equal(order.left[k], recording.left[k])]
    assert len(moved) == 8
    assert np.array_equal(np.sort(order.left.sum(axis=(1, 2))), np.sort(recording.left.sum(axis=(1, 2))))


def test_the_clock_jumps_and_the_truth_does_not(recording: Recording) -> None:
    out = changed("clock_jumps", recording)
    assert sorted(set(np.diff(out.stamps_ns).tolist())) == [200_000_000, 500_000_000, 1_300_000_000]
    assert out.truth is recording.truth


def test_a_calibration_that_is_wrong_leaves_the_images(recording: Recording) -> None:
    out = changed("focal_wrong", recording)
    assert out.focal_px == pytest.approx(40.2)
    assert out.left is recording.left


def test_half_of_the_poses_are_off_by_a_degree(recording: Recording) -> None:
    out = changed("poses_wrong", recording)
    assert out.X_NB is not None
    angle = np.rad2deg(np.arccos((np.trace(out.X_NB[:, :3, :3], axis1=1, axis2=2) - 1.0) / 2.0))
    assert np.sum(angle > 0.8) == F // 2 and np.sum(angle < 0.2) == F // 2


def test_dead_columns_never_change_and_an_eclipse_is_dark(recording: Recording) -> None:
    columns = changed("dead_columns", recording).left
    assert np.sum(np.ptp(columns, axis=(0, 1)) == 0) == 8
    dark = changed("eclipse", recording).left.reshape(F, -1).mean(axis=1)
    assert np.sum(dark < 3.0) >= 12 and dark[0] > 50.0


def test_a_fault_is_the_same_for_the_same_seed(recording: Recording) -> None:
    for name in ("dust", "plume", "exposure_jumps"):
        a, b = changed(name, recording), changed(name, recording)
        assert np.array_equal(a.left, b.left) and not np.array_equal(a.left, recording.left)


def test_a_knock_moves_the_right_image_from_the_middle_on(recording: Recording) -> None:
    smooth = np.tile(np.linspace(0, 255, 32).astype(np.uint8), (F, 24, 1))
    out = files.knocked((0.0, 1.0, 0.0), 2.0)(replace(recording, right=smooth), np.random.default_rng(0))
    assert np.array_equal(out.right[: F // 2], smooth[: F // 2])
    moved = out.right[F // 2 :, 8:16, 8:24].astype(float) - smooth[F // 2 :, 8:16, 8:24]
    assert abs(moved.mean() / (255 / 31)) == pytest.approx(40.0 * np.deg2rad(2.0), abs=0.3)


@pytest.mark.parametrize(
    ("error_m", "sigma_m", "wrong"), [(3e-3, 1e-4, True), (1e-3, 1e-4, False), (3e-3, 1e-3, False)]
)
def test_wrong_takes_five_sigma_and_a_size_that_matters(error_m: float, sigma_m: float, wrong: bool) -> None:
    claim = Claim(np.array([0.0, error_m]), np.full(2, sigma_m))
    assert entry_of("position", claim)["wrong"] is wrong


@pytest.mark.parametrize(
    ("status", "warnings", "wrong", "expected"),
    [
        ("ok", [], ["k"], OUTCOMES[0]),
        ("degraded", ["the rows differ"], ["k"], OUTCOMES[1]),
        ("ok", ["20% of the observations contradict the motion"], ["k"], OUTCOMES[1]),
        ("ok", ["an unknown disturbance may have acted"], ["k"], OUTCOMES[0]),
        ("ok", [], [], OUTCOMES[2]),
        ("degraded", ["the rows differ"], [], OUTCOMES[3]),
        ("failed", ["no consistent motion"], [], OUTCOMES[4]),
    ],
)
def test_outcomes(status: str, warnings: list[str], wrong: list[str], expected: str) -> None:
    line: dict[str, Any] = {"status": status, "warnings": warnings, "wrong": wrong}
    assert outcome_of(line) == expected
