"""The inspector takes the path that the scene names; a limit cycle stays in its band."""

import pickle  # noqa: TID251  as multiprocessing passes it to workers
from typing import Any

import numpy as np
import pytest

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array, exp_so3, log_so3
from polhode.runtime.errors import InputError
from polhode.simulation.motion.inspector import (
    PULSE_S,
    RATE_VARIATION,
    InspectorMotion,
    LimitCycle,
    inspector_motion,
    limit_cycle,
    reported_inspector,
)

WAYPOINTS: list[dict[str, Any]] = [
    {"t_s": 2.0, "position_m": [0.0, 0.0, 0.0]},
    {"t_s": 8.0, "position_m": [0.2, 0.0, 0.0], "attitude_deg": [0, -20, 0]},
    {"t_s": 13.0, "position_m": [0.3, 0.1, 0.1], "attitude_deg": [10, -40, 60]},
    {"t_s": 18.0, "position_m": [0.3, 0.2, 0.2], "attitude_deg": [0, -40, 90]},
]
JITTER: dict[str, Any] = {"deadband_mm": 4.0, "deadband_mm_s": 2.0, "deadband_deg": 0.5}
COURSES: dict[str, dict[str, Any]] = {
    "rest": {},
    "drift": {"velocity_mm_s": [5, 2, -3], "rate_deg_s": [0.2, 0.4, -0.3], "attitude_deg": [10, 0, 0]},
    "circle": {"circle_period_s": 40.0, "position_m": [0.1, 0.0, 0.1], "attitude_deg": [0, 5, 0]},
    "approach": {"approach_mm_s": 30.0, "approach_stop_m": 0.5, "attitude_deg": [0, 5, 0]},
    "waypoints": {"waypoints": WAYPOINTS},
}
TARGET_N = np.array([0.0, 0.0, 0.8])


def _motion(
    profile: str, frames: int = 41, seed: int = 3, interval_s: float = 0.5, **more: Any
) -> InspectorMotion:
    inspector = {"profile": profile, **COURSES[profile], **more}
    motion = {"position_m": TARGET_N.tolist()}
    scene = {"frames": frames, "interval_s": interval_s, "motion": motion, "inspector": inspector}
    return inspector_motion(Scene.model_validate(scene), seed)


def _velocity(motion: InspectorMotion, k: int) -> Array:
    """v_N and w_C (6,) at frame k, by central differences."""
    before, after = motion.poses_during(k, [-1e-5, 1e-5])
    turn = log_so3(before[:3, :3].T @ after[:3, :3])
    return np.concatenate([after[:3, 3] - before[:3, 3], turn]) / 2e-5


@pytest.mark.parametrize("profile", COURSES)
def test_poses_are_smooth_depend_on_time_and_seed_alone_and_travel_to_another_process(profile: str) -> None:
    motion = _motion(profile, frames=20_001, interval_s=0.001, **JITTER)
    v_N = np.diff(motion.X_NC[:, :3, 3], axis=0) / 0.001
    w_C = log_so3(np.swapaxes(motion.X_NC[:-1, :3, :3], 1, 2) @ motion.X_NC[1:, :3, :3]) / 0.001
    assert np.abs(np.diff(v_N, axis=0)).max() < 0.1 * 0.001
    assert np.abs(np.diff(w_C, axis=0)).max() < 0.3 * 0.001
    coarse, fine = (_motion(profile, n, interval_s=dt, **JITTER) for n, dt in [(5, 2.0), (33, 0.25)])
    np.testing.assert_allclose(coarse.X_NC, fine.X_NC[::8], atol=1e-14)
    np.testing.assert_array_equal(fine.poses_during(0, fine.t_s), fine.X_NC)
    assert np.abs(_motion(profile, 33, 4, 0.25, **JITTER).X_NC - fine.X_NC).max() > 1e-3
    np.testing.assert_array_equal(_motion(profile, seed=3).X_NC, _motion(profile, seed=4).X_NC)
    moved = pickle.loads(pickle.dumps(fine))  # noqa: S301
    np.testing.assert_array_equal(moved.poses_during(7, [0.1]), fine.poses_during(7, [0.1]))


@pytest.mark.parametrize("profile", ["rest", "circle"])
def test_jitter_stays_within_its_bands_around_the_course(profile: str) -> None:
    steady, jittery = _motion(profile, frames=200), _motion(profile, frames=200, **JITTER)
    offset_mm = 1e3 * (jittery.X_NC - steady.X_NC)[:, :3, 3]
    turn_deg = np.rad2deg(log_so3(np.swapaxes(steady.X_NC[:, :3, :3], 1, 2) @ jittery.X_NC[:, :3, :3]))
    for deviation, band in ((offset_mm, 4.0), (turn_deg, 0.5)):
        assert (np.abs(deviation).max(axis=0) <= band).all()
        assert (np.abs(deviation).max(axis=0) > 0.8 * band).all()
        # Six axes that start together do not stay together.
        assert np.abs(np.corrcoef(deviation.T) - np.eye(3)).max() < 0.9
    if profile == "rest":
        np.testing.assert_array_equal(jittery.X_NC[0], np.eye(4))
        np.testing.assert_array_equal(steady.X_NC, np.tile(np.eye(4), (200, 1, 1)))


def test_a_drift_is_steady_and_a_circle_keeps_the_target_where_the_first_frame_has_it() -> None:
    motion = _motion("drift")
    np.testing.assert_allclose(motion.X_NC[:, :3, 3], motion.t_s[:, None] * [5e-3, 2e-3, -3e-3], atol=1e-15)
    turn = log_so3(np.swapaxes(motion.X_NC[:-1, :3, :3], 1, 2) @ motion.X_NC[1:, :3, :3])
    np.testing.assert_allclose(np.rad2deg(turn), np.tile([0.1, 0.2, -0.15], (40, 1)), atol=1e-12)
    motion = _motion("circle")
    p_C = [X_NC[:3, :3].T @ (TARGET_N - X_NC[:3, 3]) for X_NC in motion.X_NC]
    np.testing.assert_allclose(p_C, np.tile(p_C[0], (41, 1)), atol=1e-12)
    speed = 2 * np.pi / 40.0 * np.hypot(0.1, 0.7)
    assert np.linalg.norm(_velocity(motion, 9)[:3]) == pytest.approx(speed, rel=1e-9)


def test_an_approach_closes_in_at_its_speed_and_stops_at_its_distance() -> None:
    motion = _motion("approach")
    distance_m = np.linalg.norm(TARGET_N - motion.X_NC[:, :3, 3], axis=1)
    cruising = motion.t_s < 9.0
    np.testing.assert_allclose(distance_m[cruising], 0.8 - 0.03 * motion.t_s[cruising], atol=1e-12)
    np.testing.assert_allclose(distance_m[motion.t_s > 11.0], 0.5, atol=1e-12)
    assert (np.diff(distance_m) <= 1e-15).all()
    np.testing.assert_array_equal(motion.X_NC[:, :3, :3], np.tile(motion.X_NC[0, :3, :3], (41, 1, 1)))
    with pytest.raises(InputError, match=r"scene.inspector.position_m .* must start away from it"):
        _motion("approach", position_m=TARGET_N.tolist())
    for stop_m, reached_m in ((0.9, 0.8), (0.799, 0.799)):
        motion = _motion("approach", approach_stop_m=stop_m)
        assert np.linalg.norm(TARGET_N - motion.X_NC[-1, :3, 3]) == pytest.approx(reached_m, abs=1e-12)
        np.testing.assert_allclose(_velocity(motion, 40)[:3], 0.0, atol=1e-9)


def test_waypoints_are_met_in_time_the_ends_hold_and_two_are_joined_by_a_line() -> None:
    motion = _motion("waypoints")
    for point in WAYPOINTS:
        k = round(2 * point["t_s"])
        np.testing.assert_allclose(motion.X_NC[k, :3, 3], point["position_m"], atol=1e-14)
        R_NC = exp_so3(np.deg2rad(point.get("attitude_deg", [0, 0, 0])))
        np.testing.assert_allclose(motion.X_NC[k, :3, :3], R_NC, atol=1e-14)
    for held in (slice(0, 5), slice(36, None)):
        np.testing.assert_allclose(motion.X_NC[held], motion.X_NC[held][:1].repeat(5, axis=0), atol=1e-14)
    on_line = _motion("waypoints", waypoints=WAYPOINTS[:2]).X_NC[:, :3, 3]
    np.testing.assert_array_equal(on_line[:, 1:], 0.0)
    assert (np.diff(on_line[:, 0]) >= 0).all()
    assert on_line[10, 0] == pytest.approx(0.1)


def test_reported_poses_scatter_as_the_scene_says() -> None:
    inspector = {"profile": "drift", "sigma_p_m": 1e-3, "sigma_theta_deg": 0.1}
    scene = Scene.model_validate({"frames": 2000, "inspector": inspector})
    X_NC = inspector_motion(scene, 0).X_NC
    reported = reported_inspector(scene, X_NC, np.eye(4), np.random.default_rng(0))
    assert (reported[:, :3, 3] - X_NC[:, :3, 3]).std() == pytest.approx(1e-3, rel=0.05)
    theta = log_so3(np.swapaxes(X_NC[:, :3, :3], 1, 2) @ reported[:, :3, :3])
    assert np.rad2deg(theta).std() == pytest.approx(0.1, rel=0.05)


T_S = np.linspace(0.0, 300.0, 100_000)


def _cycle(half_width: float = 0.01, rate: float = 0.004, stop_s: float = 301.0, seed: int = 1) -> LimitCycle:
    return limit_cycle(half_width, rate, stop_s, np.random.default_rng(seed))


def test_a_limit_cycle_starts_in_the_middle_and_fills_its_band_without_leaving_it() -> None:
    for half_width, rate in [(0.01, 0.004), (0.001, 0.02)]:
        cycle = _cycle(half_width, rate)
        value = cycle.value(T_S)
        assert cycle.value(np.zeros(1))[0] == 0.0
        assert np.abs(value).max() <= half_width
        assert value.max() > 0.9 * half_width and value.min() < -0.9 * half_width
    for half_width, rate in [(0.0, 1.0), (1.0, 0.0)]:
        np.testing.assert_array_equal(_cycle(half_width, rate).value(T_S), 0.0)


def test_between_pulses_it_drifts_near_the_nominal_rate_and_velocity_is_continuous() -> None:
    cycle = _cycle()
    slope = np.asarray((cycle.value(T_S + 1e-6) - cycle.value(T_S - 1e-6)) / 2e-6)
    pulsing = np.abs(T_S[:, None] - cycle.corner_s).min(axis=1) < PULSE_S / 2
    rates = np.unique(np.abs(slope[~pulsing]).round(8))
    assert 40 < len(rates) < 80
    assert 0.004 * (1 - RATE_VARIATION) <= rates.min() < rates.max() <= 0.004 * (1 + RATE_VARIATION)
    expected = PULSE_S * len(cycle.corner_s[cycle.corner_s < 300]) / 300
    assert pulsing.mean() == pytest.approx(expected, rel=0.05)
    assert (cycle.rate[1:] * cycle.rate[:-1] < 0).all()
    largest_step = 2 * 0.004 * (1 + RATE_VARIATION) / PULSE_S * (T_S[1] - T_S[0])
    assert np.abs(np.diff(slope)).max() <= largest_step * 1.001 + 1e-8
    np.testing.assert_array_equal(_cycle(stop_s=100.0).value(T_S[:30_000]), cycle.value(T_S[:30_000]))
    assert np.abs(_cycle(seed=2).value(T_S) - cycle.value(T_S)).max() > 0.005
