"""Pushes move the target as Newton and Euler say; white disturbances have the stated spectral density.

What is written of known pushes says the same to readers that hold rows and that interpolate.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.geometry.lie import Array
from polhode.simulation.dataset.sequence import plan_sequence, write_estimator_inputs
from polhode.simulation.motion.forces import known_wrench
from polhode.simulation.motion.target import TargetMotion, target_motion, timestamps
from tests.simulation.motion.motion_scenes import MASS_KG, mass_of, scene_of

SPHERE = np.array([0.02, 0.02, 0.02])
"""Equal moments: torques about the axes do not mix."""


PUSHES = [
    {"start_s": 0.0, "duration_s": 1.25, "force_N": [0.01, 0.0, 0.0], "torque_P": [0.0, 1e-3, 0.0]},
    {
        "start_s": 1.2,
        "duration_s": 2.0,
        "force_N": [0.0, 0.02, 0.0],
        "torque_P": [0, 0, 1e-3],
        "period_s": 0.8,
    },
    {"start_s": 4.4, "duration_s": 99.0, "force_N": [0.0, 0.0, -0.01]},
]


def _pushed(*pushes: dict[str, Any], interval_s: float = 0.5, frames: int = 21) -> TargetMotion:
    return target_motion(scene_of(frames, interval_s, pushes=pushes), mass_of(SPHERE), 0)


def test_constant_forces_sines_and_overlaps_change_velocity_by_their_integrals() -> None:
    motion = _pushed({"start_s": 1.3, "duration_s": 4.0, "force_N": [0.02, 0.0, -0.01]})
    on_s = np.clip(motion.t_s - 1.3, 0.0, 4.0)
    accel_N = np.array([0.02, 0.0, -0.01]) / MASS_KG
    np.testing.assert_allclose(motion.v_N, on_s[:, None] * accel_N, atol=1e-15)
    way = 0.5 * on_s**2 + on_s * (motion.t_s - 1.3 - on_s) * (motion.t_s > 1.3)
    np.testing.assert_allclose(motion.r_N - motion.r_N[0], way[:, None] * accel_N, atol=1e-14)
    np.testing.assert_allclose(motion.w_P, 0.0, atol=1e-300)
    period_s, torque = 1.7, 2e-3
    motion = _pushed({"start_s": 0.4, "duration_s": 4.0, "torque_P": [0, torque, 0], "period_s": period_s})
    rate = 2 * np.pi / period_s
    on_s = np.clip(motion.t_s - 0.4, 0.0, 4.0)
    expected = torque / SPHERE[1] * (1 - np.cos(rate * on_s)) / rate
    np.testing.assert_allclose(motion.w_P[:, 1], expected, atol=1e-13)
    motion = _pushed(
        {"start_s": 0.0, "duration_s": 6.0, "force_N": [0.01, 0, 0]},
        {"start_s": 2.0, "duration_s": 8.0, "force_N": [0.03, 0, 0], "torque_P": [0, 0, 1e-3]},
    )
    assert motion.v_N[-1, 0] == pytest.approx((0.01 * 6 + 0.03 * 8) / MASS_KG, rel=1e-12)
    assert motion.w_P[-1, 2] == pytest.approx(1e-3 * 8 / SPHERE[2], rel=1e-12)


def test_a_torque_of_the_body_turns_with_the_body() -> None:
    """Thrust about a body axis while the body spins about it and another: momentum in N by the integral."""
    push = {"start_s": 0.3, "duration_s": 2.0, "torque_P": [1e-3, 0.0, 2e-3]}
    scene = scene_of(301, 0.01, pushes=[push], spin_rpm=[3.0, 20.0, 1.0])
    mass = mass_of(np.array([0.03, 0.02, 0.015]))
    motion = target_motion(scene, mass, 0)
    h_N = (motion.R_NP @ motion.h_P[..., None])[..., 0]
    torque_N = (motion.R_NP @ np.array([1e-3, 0.0, 2e-3])[:, None])[..., 0]
    on = torque_N[30:231]
    # Simpson's rule over the push.
    weights = np.ones(201) * np.where(np.arange(201) % 2 == 1, 4.0, 2.0)
    weights[[0, -1]] = 1.0
    np.testing.assert_allclose(h_N[-1] - h_N[0], weights @ on * 0.01 / 3.0, atol=1e-10)


def test_results_do_not_depend_on_where_the_frames_lie() -> None:
    push = {"start_s": 0.37, "duration_s": 2.2, "torque_P": [1e-3, 0.0, 2e-3], "period_s": 0.9}
    moving: dict[str, Any] = {"pushes": [push], "spin_rpm": [3.0, 9.0, 1.0], "energy_loss": 0.2}
    a = target_motion(scene_of(2, 3.0, **moving), mass_of(), 0)
    b = target_motion(scene_of(7, 0.5, **moving), mass_of(), 0)
    np.testing.assert_allclose(a.X_NG[-1], b.X_NG[-1], atol=1e-12)


@pytest.fixture(scope="module")
def disturbed() -> TargetMotion:
    """4000 intervals of a body that hardly turns, so that torques in P are torques in N."""
    scene = scene_of(4001, 0.1, accel_psd=4e-6, torque_psd=9e-10)
    return target_motion(scene, mass_of(SPHERE), 11)


def test_white_disturbances_have_the_stated_density(disturbed: TargetMotion) -> None:
    """Position step minus that of the old velocity: variance psd dt^3 / 3, correlation sqrt(3)/2 with v's."""
    steps = np.diff(disturbed.v_N, axis=0)
    np.testing.assert_allclose(steps.var(axis=0), 4e-6 * 0.1, rtol=4 * np.sqrt(2 / 4000))
    assert np.abs(steps.mean(axis=0)).max() < 4 * np.sqrt(4e-7 / 4000)
    following = np.sum(steps[1:] * steps[:-1], axis=0) / np.sum(steps**2, axis=0)
    assert np.abs(following).max() < 4 / np.sqrt(4000)
    steps = np.diff(disturbed.h_P, axis=0) / SPHERE[1]
    np.testing.assert_allclose(steps.var(axis=0), 9e-10 * 0.1, rtol=4 * np.sqrt(2 / 4000))
    step_r = np.diff(disturbed.r_N, axis=0) - 0.1 * disturbed.v_N[:-1]
    np.testing.assert_allclose(step_r.var(axis=0), 4e-6 * 0.1**3 / 3, rtol=0.1)
    for axis in range(3):
        combined_mass = np.corrcoef(step_r[:, axis], np.diff(disturbed.v_N[:, axis]))[0, 1]
        assert combined_mass == pytest.approx(np.sqrt(3) / 2, abs=0.02)


def test_unequal_moments_take_unequal_steps_of_rate() -> None:
    moments = np.array([0.04, 0.03, 0.02])
    motion = target_motion(scene_of(2001, 0.1, torque_psd=1e-12), mass_of(moments), 5)
    steps = np.diff(motion.w_P, axis=0)
    expected = 1e-12 * 0.1 * (moments[1] / moments) ** 2
    np.testing.assert_allclose(steps.var(axis=0), expected, rtol=4 * np.sqrt(2 / 2000))


def test_disturbances_are_constant_for_a_twentieth_of_an_interval_at_most() -> None:
    for interval_s, cell_s in ((0.5, 0.025), (2.0, 0.025), (0.1, 0.005)):
        motion = target_motion(scene_of(3, interval_s=interval_s, accel_psd=1e-6), mass_of(), 0)
        assert motion.forces.knots_s[0] == pytest.approx(cell_s)


def test_white_noise_and_pushes_and_drag_act_together() -> None:
    push = {"start_s": 1.0, "duration_s": 3.0, "force_N": [0.1, 0, 0]}
    alone = target_motion(scene_of(20, accel_psd=1e-6), mass_of(), 3)
    both = target_motion(scene_of(20, accel_psd=1e-6, pushes=[push], energy_loss=0.3), mass_of(), 3)
    added = np.clip(alone.t_s - 1.0, 0.0, 3.0) * 0.1 / MASS_KG
    np.testing.assert_allclose(both.v_N[:, 0] - alone.v_N[:, 0], added, atol=1e-14)
    np.testing.assert_allclose(both.v_N[:, 1:], alone.v_N[:, 1:], atol=1e-14)


def _rows() -> tuple[Array, Array, Array]:
    scene = scene_of(11, 0.5, 1.0, pushes=PUSHES)
    known = known_wrench(scene.motion, timestamps(scene))
    assert known is not None
    stamps, force_N, torque_P = known
    return (stamps - scene.start_ns) / 1e9, force_N, torque_P


def test_rows_cover_the_truth_at_20_hz_with_1_ns_at_jumps_and_torques_beside_forces() -> None:
    t_s, _, _ = _rows()
    assert t_s[0] == 0.0
    assert t_s[-1] == 6.0
    assert (np.diff(t_s) > 0).all()
    assert np.diff(t_s).max() <= 0.05 + 1e-9
    t_s, force_N, _ = _rows()
    for edge_s, axis, before, after in [(1.25, 0, 0.01, 0.0), (4.4, 2, 0.0, -0.01)]:
        row = int(np.searchsorted(t_s, edge_s - 1e-12))
        assert t_s[row] == pytest.approx(edge_s, abs=1e-12)
        assert t_s[row] - t_s[row - 1] == pytest.approx(1e-9, rel=1e-3)
        assert (force_N[row - 1, axis], force_N[row, axis]) == (before, after)
    t_s, _, torque_P = _rows()
    inside = (t_s > 1.25) & (t_s < 3.2 - 1e-12)
    expected = 1e-3 * np.sin(2 * np.pi * (t_s[inside] - 1.2) / 0.8)
    np.testing.assert_allclose(torque_P[inside, 2], expected, atol=1e-9)
    np.testing.assert_array_equal(torque_P[t_s < 1.25 - 1e-12, 1], 1e-3)


@pytest.mark.parametrize("reader", ["hold", "interpolate"])
def test_either_reading_gives_the_velocity_of_the_truth(reader: str) -> None:
    t_s, force_N, _ = _rows()
    dt = np.diff(t_s)[:, None]
    mean_N = force_N[:-1] if reader == "hold" else 0.5 * (force_N[:-1] + force_N[1:])
    v_N = np.concatenate([np.zeros((1, 3)), np.cumsum(mean_N * dt, axis=0)]) / MASS_KG
    motion = target_motion(scene_of(11, 0.5, 1.0, pushes=PUSHES), mass_of(), 0)
    read = np.stack([np.interp(motion.t_s, t_s, v_N[:, axis]) for axis in range(3)], axis=1)
    np.testing.assert_allclose(read, motion.v_N, atol=2e-5 if reader == "hold" else 1e-6)


@pytest.mark.parametrize("motion", [{}, {"pushes": PUSHES, "pushes_known": False}])
def test_nothing_is_known_without_pushes_or_when_they_are_kept_back(motion: dict[str, Any]) -> None:
    scene = scene_of(3, **motion)
    assert known_wrench(scene.motion, timestamps(scene)) is None


@pytest.mark.parametrize("known", [True, False])
def test_a_sequence_tells_the_pushes_when_they_are_known(known: bool, tmp_path: Path) -> None:
    scene = scene_of(3, pushes=PUSHES, pushes_known=known, position_m=[0.0, 0.0, 0.8])
    write_estimator_inputs(plan_sequence(scene, 0), tmp_path)
    path = tmp_path / "wrench0" / "data.csv"
    assert path.exists() == known
    if known:
        first = path.read_text().splitlines()[1].split(",")
        assert [float(value) for value in first] == [scene.start_ns, 0.01, 0, 0, 0, 1e-3, 0]
