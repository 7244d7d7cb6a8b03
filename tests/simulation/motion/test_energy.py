"""Loss of energy: as much as stated, by drag in closed form, by friction without loss of momentum."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array
from polhode.geometry.rigid_body import angular_momentum_N, rotational_energy
from polhode.runtime.errors import InputError
from polhode.simulation.motion.forces import (
    energy_of_momentum,
    excess_energy,
    friction_for_loss,
    loss_coefficients,
    momentum_of_rate,
)
from polhode.simulation.motion.integrate import body_rate
from polhode.simulation.motion.target import TargetMotion, target_motion
from tests.simulation.motion.motion_scenes import TRIAXIAL, mass_of, rpm, scene_of

SLENDER = np.array([1.3, 1.0, 0.45])
MINOR_SPIN = np.array([0.05, 0.12, 1.2])


def _losing(by: str, share: float, horizon_s: float, moments: Array, w_P: Array) -> TargetMotion:
    loss: dict[str, Any] = {"energy_loss": share, "energy_loss_by": by, "spin_rpm": rpm(w_P)}
    return target_motion(scene_of(interval_s=1.0, horizon_s=horizon_s, **loss), mass_of(moments), 0)


def test_drag_takes_the_stated_share_and_keeps_the_direction_of_momentum() -> None:
    """The step follows the drag where that is the faster of the two."""
    motion = _losing("drag", 0.078, 200.0, TRIAXIAL, np.array([0.05, 1.05, 0.05]))
    energy = rotational_energy(np.diag(TRIAXIAL), motion.w_P)
    assert 1 - energy[80] / energy[0] == pytest.approx(0.078, rel=1e-9)
    c = -np.log(1 - 0.078) / 160
    np.testing.assert_allclose(energy, energy[0] * np.exp(-2 * c * motion.t_s), rtol=1e-10)
    motion = _losing("drag", 0.5, 100.0, SLENDER, np.array([0.3, 1.0, 0.2]))
    momentum = angular_momentum_N(np.diag(SLENDER), motion.R_NP, motion.w_P)
    expected = momentum[0] * np.exp(np.log(0.5) / 160 * motion.t_s)[:, None]
    np.testing.assert_allclose(momentum, expected, atol=1e-10)
    w_P = np.array([0.1, 1.0, 0.1])
    motion = _losing("drag", 0.99, 0.01, TRIAXIAL, w_P)
    assert np.isfinite(motion.h_P).all() and np.isfinite(motion.R_NP).all()


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9])
def test_friction_takes_the_stated_share_of_the_excess_and_no_momentum(share: float) -> None:
    motion = _losing("friction", share, 160.0, SLENDER, MINOR_SPIN)
    excess = excess_energy(motion.h_P, SLENDER)
    assert 1 - excess[80] / excess[0] == pytest.approx(share, rel=1e-8)
    assert (np.diff(energy_of_momentum(motion.h_P, SLENDER)) < 0).all()
    momentum_N = (motion.R_NP @ motion.h_P[..., None])[..., 0]
    assert np.abs(momentum_N - momentum_N[0]).max() < 1e-9 * np.linalg.norm(momentum_N[0])


def test_friction_turns_a_minor_axis_spin_into_a_flat_spin() -> None:
    motion = _losing("friction", 0.9, 600.0, SLENDER, MINOR_SPIN)
    tilt_deg = np.rad2deg(np.arccos(np.abs(motion.w_P) / np.linalg.norm(motion.w_P, axis=1)[:, None]))
    assert tilt_deg[0, 2] < 10.0
    assert tilt_deg[-1, 0] < 1.0
    # The same momentum about the greatest axis: slower.
    assert np.linalg.norm(motion.w_P[-1]) == pytest.approx(
        np.linalg.norm(SLENDER * MINOR_SPIN) / SLENDER[0], rel=0.02
    )
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
        return np.concatenate(
            [(torque - np.cross(w, shell * w)) / shell, -torque / ball - np.cross(w, w_ball)]
        )

    lag = -np.cross(SLENDER * w_P, w_P) / SLENDER / coupling_hz
    start = np.concatenate([w_P, w_P + lag])
    solution = solve_ivp(derivative, (0.0, 80.0), start, "DOP853", rtol=1e-9, atol=1e-12)
    excess = []
    for y in (start, solution.y[:, -1]):
        h = shell * y[:3] + ball * y[3:]
        energy = 0.5 * shell @ y[:3] ** 2 + 0.5 * ball * y[3:] @ y[3:]
        excess.append(energy - 0.5 * h @ h / SLENDER[0])
    assert 1 - excess[1] / excess[0] == pytest.approx(0.05, rel=0.03)


@pytest.mark.parametrize(
    ("loss", "w_P", "words"),
    [
        ({"energy_loss": 1.0}, [0, 1, 0], "give a share below 1"),
        ({"energy_loss": 0.1, "energy_loss_by": "friction"}, [1, 0, 0], "about a principal axis"),
        ({"energy_loss": 0.1, "energy_loss_by": "friction"}, [0, 1, 0], "about a principal axis"),
        (
            {"energy_loss": 0.9, "energy_loss_by": "friction", "energy_loss_s": 2.0},
            [0.1, 0.2, 1.0],
            "a longer energy_loss_s",
        ),
    ],
)
def test_a_loss_that_cannot_be_is_refused(loss: dict[str, object], w_P: list[float], words: str) -> None:
    motion = config.Motion.model_validate(loss)
    with pytest.raises(InputError, match=words) as caught:
        loss_coefficients(motion, SLENDER, np.array(w_P, dtype=np.float64))
    assert "\n" not in str(caught.value)
    assert "scene.motion.energy_loss" in str(caught.value)
