"""What acts on the target: pushes, white disturbances of a spectral density, loss of energy."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array
from polhode.geometry.rigid_body import angular_momentum_N, rotational_energy
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.sequence import plan_sequence, write_estimator_inputs
from polhode.simulation.motion.forces import (
    energy_of_momentum,
    excess_energy,
    friction_for_loss,
    known_wrench,
    loss_coefficients,
    momentum_of_rate,
)
from polhode.simulation.motion.integrate import body_rate
from polhode.simulation.motion.target import TargetMotion, target_motion, timestamps
from tests.simulation.motion.motion_scenes import MASS_KG, TRIAXIAL, mass_of, rpm, scene_of

SPHERE = np.array([0.02, 0.02, 0.02])
"""Equal moments: torques about the axes do not mix."""
SLENDER = np.array([1.3, 1.0, 0.45])
MINOR_SPIN = np.array([0.05, 0.12, 1.2])
PUSHES = [
    {"start_s": 0.0, "duration_s": 1.25, "force_N": [0.01, 0.0, 0.0], "torque_P": [0.0, 1e-3, 0.0]},
    {"start_s": 1.2, "duration_s": 2.0, "force_N": [0.0, 0.02, 0.0], "torque_P": [0, 0, 1e-3]},
    {"start_s": 4.4, "duration_s": 99.0, "force_N": [0.0, 0.0, -0.01]},
]


def _pushed(*pushes: dict[str, Any]) -> TargetMotion:
    return target_motion(scene_of(21, pushes=pushes), mass_of(SPHERE), 0)


def test_constant_and_overlapping_forces_change_velocity_by_their_integrals() -> None:
    motion = _pushed({"start_s": 1.3, "duration_s": 4.0, "force_N": [0.02, 0.0, -0.01]})
    on_s = np.clip(motion.t_s - 1.3, 0.0, 4.0)
    accel_N = np.array([0.02, 0.0, -0.01]) / MASS_KG
    np.testing.assert_allclose(motion.v_N, on_s[:, None] * accel_N, atol=1e-15)
    way = 0.5 * on_s**2 + on_s * (motion.t_s - 1.3 - on_s) * (motion.t_s > 1.3)
    np.testing.assert_allclose(motion.r_N - motion.r_N[0], way[:, None] * accel_N, atol=1e-14)
    np.testing.assert_allclose(motion.w_P, 0.0, atol=1e-300)
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
    motion = target_motion(scene, mass_of(np.array([0.03, 0.02, 0.015])), 0)
    h_N = (motion.R_NP @ motion.h_P[..., None])[..., 0]
    torque_N = (motion.R_NP @ np.array([1e-3, 0.0, 2e-3])[:, None])[30:231, :, 0]
    # Simpson's rule over the push.
    weights = np.ones(201) * np.where(np.arange(201) % 2 == 1, 4.0, 2.0)
    weights[[0, -1]] = 1.0
    np.testing.assert_allclose(h_N[-1] - h_N[0], weights @ torque_N * 0.01 / 3.0, atol=1e-10)


def test_results_do_not_depend_on_where_the_frames_lie() -> None:
    push = {"start_s": 0.37, "duration_s": 2.2, "torque_P": [1e-3, 0.0, 2e-3]}
    moving: dict[str, Any] = {"pushes": [push], "spin_rpm": [3.0, 9.0, 1.0], "energy_loss": 0.2}
    a, b = (target_motion(scene_of(n, dt, **moving), mass_of(), 0) for n, dt in ((2, 3.0), (7, 0.5)))
    np.testing.assert_allclose(a.X_NG[-1], b.X_NG[-1], atol=1e-12)


def test_white_disturbances_have_the_stated_density() -> None:
    """Position step minus that of the old velocity: variance psd dt^3 / 3, correlation sqrt(3)/2 with v's."""
    # The body hardly turns, so that torques in P are torques in N.
    disturbed = target_motion(scene_of(4001, 0.1, accel_psd=4e-6, torque_psd=9e-10), mass_of(SPHERE), 11)
    steps = np.diff(disturbed.v_N, axis=0)
    np.testing.assert_allclose(steps.var(axis=0), 4e-6 * 0.1, rtol=4 * np.sqrt(2 / 4000))
    assert np.abs(steps.mean(axis=0)).max() < 4 * np.sqrt(4e-7 / 4000)
    following = np.sum(steps[1:] * steps[:-1], axis=0) / np.sum(steps**2, axis=0)
    assert np.abs(following).max() < 4 / np.sqrt(4000)
    turns = np.diff(disturbed.h_P, axis=0) / SPHERE[1]
    np.testing.assert_allclose(turns.var(axis=0), 9e-10 * 0.1, rtol=4 * np.sqrt(2 / 4000))
    step_r = np.diff(disturbed.r_N, axis=0) - 0.1 * disturbed.v_N[:-1]
    np.testing.assert_allclose(step_r.var(axis=0), 4e-6 * 0.1**3 / 3, rtol=0.1)
    for axis in range(3):
        assert np.corrcoef(step_r[:, axis], steps[:, axis])[0, 1] == pytest.approx(np.sqrt(3) / 2, abs=0.02)
    moments = np.array([0.04, 0.03, 0.02])
    motion = target_motion(scene_of(2001, 0.1, torque_psd=1e-12), mass_of(moments), 5)
    expected = 1e-12 * 0.1 * (moments[1] / moments) ** 2
    np.testing.assert_allclose(np.diff(motion.w_P, axis=0).var(axis=0), expected, rtol=4 * np.sqrt(2 / 2000))
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


def test_rows_of_known_pushes_say_the_same_to_readers_that_hold_and_that_interpolate() -> None:
    """They cover the truth at 20 Hz, with 1 ns at jumps, torques beside forces."""
    scene = scene_of(11, 0.5, 1.0, pushes=PUSHES)
    known = known_wrench(scene.motion, timestamps(scene))
    assert known is not None
    stamps, force_N, torque_P = known
    t_s = (stamps - scene.start_ns) / 1e9
    assert (t_s[0], t_s[-1]) == (0.0, 6.0)
    assert (np.diff(t_s) > 0).all() and np.diff(t_s).max() <= 0.05 + 1e-9
    for edge_s, axis, before, after in [(1.25, 0, 0.01, 0.0), (4.4, 2, 0.0, -0.01)]:
        row = int(np.searchsorted(t_s, edge_s - 1e-12))
        assert t_s[row] == pytest.approx(edge_s, abs=1e-12)
        assert t_s[row] - t_s[row - 1] == pytest.approx(1e-9, rel=1e-3)
        assert (force_N[row - 1, axis], force_N[row, axis]) == (before, after)
    np.testing.assert_array_equal(torque_P[:, 1], np.where(t_s < 1.25 - 1e-12, 1e-3, 0.0))
    motion = target_motion(scene, mass_of(), 0)
    for mean_N, atol in ((force_N[:-1], 2e-5), (0.5 * (force_N[:-1] + force_N[1:]), 1e-6)):
        steps = np.cumsum(mean_N * np.diff(t_s)[:, None], axis=0) / MASS_KG
        v_N = np.concatenate([np.zeros((1, 3)), steps])
        read = np.stack([np.interp(motion.t_s, t_s, v_N[:, axis]) for axis in range(3)], axis=1)
        np.testing.assert_allclose(read, motion.v_N, atol=atol)
    assert known_wrench(scene_of(3).motion, timestamps(scene)) is None


@pytest.mark.parametrize("known", [True, False])
def test_a_sequence_tells_the_pushes_when_they_are_known(known: bool, tmp_path: Path) -> None:
    scene = scene_of(3, pushes=PUSHES, pushes_known=known, position_m=[0.0, 0.0, 0.8])
    write_estimator_inputs(plan_sequence(scene, 0), tmp_path)
    path = tmp_path / "wrench0" / "data.csv"
    assert path.exists() == known
    if known:
        first = path.read_text().splitlines()[1].split(",")
        assert [float(value) for value in first] == [scene.start_ns, 0.01, 0, 0, 0, 1e-3, 0]


def _losing(by: str, share: float, horizon_s: float, moments: Array, w_P: Array) -> TargetMotion:
    loss: dict[str, Any] = {"energy_loss": share, "energy_loss_by": by, "spin_rpm": rpm(w_P)}
    return target_motion(scene_of(interval_s=1.0, horizon_s=horizon_s, **loss), mass_of(moments), 0)


def test_drag_takes_the_stated_share_and_keeps_the_direction_of_momentum() -> None:
    motion = _losing("drag", 0.078, 200.0, TRIAXIAL, np.array([0.05, 1.05, 0.05]))
    energy = rotational_energy(np.diag(TRIAXIAL), motion.w_P)
    assert 1 - energy[80] / energy[0] == pytest.approx(0.078, rel=1e-9)
    c = -np.log(1 - 0.078) / 160
    np.testing.assert_allclose(energy, energy[0] * np.exp(-2 * c * motion.t_s), rtol=1e-10)
    motion = _losing("drag", 0.5, 100.0, SLENDER, np.array([0.3, 1.0, 0.2]))
    momentum = angular_momentum_N(np.diag(SLENDER), motion.R_NP, motion.w_P)
    expected = momentum[0] * np.exp(np.log(0.5) / 160 * motion.t_s)[:, None]
    np.testing.assert_allclose(momentum, expected, atol=1e-10)


@pytest.mark.parametrize("share", [0.05, 0.9])
def test_friction_takes_the_stated_share_of_the_excess_and_no_momentum(share: float) -> None:
    motion = _losing("friction", share, 600.0 if share > 0.5 else 160.0, SLENDER, MINOR_SPIN)
    excess = excess_energy(motion.h_P, SLENDER)
    assert 1 - excess[80] / excess[0] == pytest.approx(share, rel=1e-8)
    assert (np.diff(energy_of_momentum(motion.h_P[:160], SLENDER)) < 0).all()
    momentum_N = (motion.R_NP @ motion.h_P[..., None])[..., 0]
    assert np.abs(momentum_N - momentum_N[0]).max() < 1e-9 * np.linalg.norm(momentum_N[0])
    if share > 0.5:
        # A spin about the least axis becomes a flat spin of the same momentum about the greatest: slower.
        tilt_deg = np.rad2deg(np.arccos(np.abs(motion.w_P) / np.linalg.norm(motion.w_P, axis=1)[:, None]))
        assert tilt_deg[0, 2] < 10.0 and tilt_deg[-1, 0] < 1.0
        slow = np.linalg.norm(SLENDER * MINOR_SPIN) / SLENDER[0]
        assert np.linalg.norm(motion.w_P[-1]) == pytest.approx(slow, rel=0.02)
    h_P = momentum_of_rate(MINOR_SPIN, SLENDER, 0.1)
    np.testing.assert_allclose(body_rate(h_P, SLENDER, 0.1), MINOR_SPIN, rtol=1e-14)
    assert np.linalg.norm(h_P - SLENDER * MINOR_SPIN) > 1e-3


def test_a_viscous_ball_inside_the_body_loses_the_same_energy() -> None:
    """The ball and the shell integrated as two bodies: every equation from Newton's third law alone."""
    w_P = np.array([0.3, 0.3, 1.0])
    friction = friction_for_loss(0.05, 80.0, SLENDER, w_P)
    ball, coupling_hz = friction * 10.0, 10.0
    shell = SLENDER - ball

    def derivative(_: float, y: Array) -> Array:
        w, w_ball = y[:3], y[3:]
        torque = ball * coupling_hz * (w_ball - w)
        of_shell = (torque - np.cross(w, shell * w)) / shell
        return np.concatenate([of_shell, -torque / ball - np.cross(w, w_ball)])

    lag = -np.cross(SLENDER * w_P, w_P) / SLENDER / coupling_hz
    start = np.concatenate([w_P, w_P + lag])
    solution = solve_ivp(derivative, (0.0, 80.0), start, "DOP853", rtol=1e-9, atol=1e-12)
    excess = []
    for y in (start, solution.y[:, -1]):
        h = shell * y[:3] + ball * y[3:]
        energy = 0.5 * shell @ y[:3] ** 2 + 0.5 * ball * y[3:] @ y[3:]
        excess.append(energy - 0.5 * h @ h / SLENDER[0])
    assert 1 - excess[1] / excess[0] == pytest.approx(0.05, rel=0.03)


FRICTION = {"energy_loss": 0.1, "energy_loss_by": "friction"}


@pytest.mark.parametrize(
    ("loss", "w_P", "words"),
    [
        ({"energy_loss": 1.0}, [0, 1, 0], "give a share below 1"),
        (FRICTION, [1, 0, 0], "about a principal axis"),
        (FRICTION, [0, 1, 0], "about a principal axis"),
        ({**FRICTION, "energy_loss": 0.9, "energy_loss_s": 2.0}, [0.1, 0.2, 1.0], "a longer energy_loss_s"),
    ],
)
def test_a_loss_that_cannot_be_is_refused(loss: dict[str, object], w_P: list[float], words: str) -> None:
    motion = config.Motion.model_validate(loss)
    with pytest.raises(InputError, match=rf"scene.motion.energy_loss.*{words}"):
        loss_coefficients(motion, SLENDER, np.array(w_P, dtype=np.float64))
