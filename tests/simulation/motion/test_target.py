"""Truth without forces: conservation laws, agreement with MuJoCo, frames that cancel."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.config.loader import load_config
from polhode.geometry.lie import Array, log_so3, matrix_from_wxyz, transform_points
from polhode.geometry.rigid_body import angular_momentum_N, rotational_energy
from polhode.simulation.bodies import build_body
from polhode.simulation.motion.mass import MassDistribution, mass_distribution
from polhode.simulation.motion.target import target_motion
from tests.simulation.motion.motion_scenes import TRIAXIAL, mass_of, scene_of

CONFIGS = Path(__file__).parents[3] / "configs"


ALL_THAT_ACTS: dict[str, Any] = {
    "accel_psd": 1e-6,
    "torque_psd": 1e-6,
    "energy_loss": 0.1,
    "energy_loss_by": "friction",
    "pushes": [
        {"start_s": 0.7, "duration_s": 2.0, "force_N": [0.01, 0.0, 0.0], "torque_P": [0.0, 1e-3, 0.0]},
        {"start_s": 0.0, "duration_s": 9.0, "torque_P": [1e-3, 0.0, 0.0], "period_s": 1.3},
    ],
}


@pytest.fixture(scope="module")
def ts38() -> config.Scene:
    scene = load_config(CONFIGS / "ts38.yaml").scene
    assert scene is not None
    return scene


@pytest.fixture(scope="module")
def mass(ts38: config.Scene) -> MassDistribution:
    return mass_distribution(ts38.mass, build_body(ts38.body, 0))


def _changed(scene: config.Scene, **changes: object) -> config.Scene:
    return scene.model_copy(update=changes)


def test_energy_and_momentum_are_constant_over_ten_minutes(
    ts38: config.Scene, mass: MassDistribution
) -> None:
    motion = target_motion(_changed(ts38, frames=1, interval_s=5.0, truth_horizon_s=600.0), mass, 0)
    J_P = np.diag(mass.moments)
    energy = rotational_energy(J_P, motion.w_P)
    momentum = angular_momentum_N(J_P, motion.R_NP, motion.w_P)
    assert np.abs(energy / energy[0] - 1).max() < 1e-9
    assert np.linalg.norm(momentum - momentum[0], axis=1).max() < 1e-9 * np.linalg.norm(momentum[0])
    np.testing.assert_allclose(motion.v_N, np.broadcast_to(motion.v_N[0], motion.v_N.shape), rtol=1e-12)


def test_the_attitude_agrees_with_mujoco_after_a_minute(ts38: config.Scene, mass: MassDistribution) -> None:
    motion = target_motion(_changed(ts38, frames=1, interval_s=60.0, truth_horizon_s=60.0), mass, 0)
    R_NP_mujoco = _mujoco_attitude(mass.moments, motion.R_NP[0], motion.w_P[0], 60.0)
    error_deg = np.rad2deg(np.linalg.norm(log_so3(motion.R_NP[-1].T @ R_NP_mujoco)))
    assert error_deg < 0.01


def _mujoco_attitude(moments: Array, R_NP: Array, w_P: Array, duration_s: float) -> Array:
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 0" integrator="RK4" timestep="0.002"/><worldbody><body><freejoint/>
        <inertial pos="0 0 0" mass="4.487" diaginertia="{" ".join(map(repr, moments.tolist()))}"/>
        </body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, R_NP.ravel())
    data.qpos[3:7], data.qvel[3:6] = quaternion, w_P
    mujoco.mj_step(model, data, nstep=round(duration_s / 0.002))
    return matrix_from_wxyz(data.qpos[3:7])


def test_frames_cancel_and_the_first_state_is_the_scenes(ts38: config.Scene, mass: MassDistribution) -> None:
    motion = target_motion(_changed(ts38, frames=5, truth_horizon_s=2.0), mass, 0)
    np.testing.assert_allclose(transform_points(motion.X_NG, mass.com_G[None])[:, 0], motion.r_N, atol=1e-15)
    np.testing.assert_allclose(motion.X_NG[:, :3, :3] @ mass.R_GP, motion.R_NP, atol=1e-14)
    w_P = np.array([0.2, -0.5, 0.3])
    spin = [float(w) for w in np.rad2deg(w_P) / 6.0]
    motion = target_motion(scene_of(2, spin_rpm=spin, **ALL_THAT_ACTS), mass_of(), 3)
    np.testing.assert_allclose(motion.w_P[0], w_P, rtol=1e-12)
    np.testing.assert_allclose(motion.h_P[0], TRIAXIAL * w_P, rtol=0.05)
    np.testing.assert_array_equal(motion.r_N[0], [0.0, 0.0, 0.6])


@pytest.mark.parametrize("acting", [{}, ALL_THAT_ACTS], ids=["free", "all acts"])
def test_poses_during_an_exposure_lie_on_the_motion_between_the_frames(acting: dict[str, Any]) -> None:
    moving = {"spin_rpm": [3.0, 8.0, 2.0], "velocity_mm_s": [5.0, -3.0, 2.0], **acting}
    motion = target_motion(scene_of(5, 0.5, **moving), mass_of(), 7)
    during = motion.poses_during(1, [-0.5, 0.0, 0.5, 1.0])
    np.testing.assert_allclose(during, motion.X_NG[:4], atol=1e-11)
    # Between frames, forwards from the one before and backwards from the one after.
    np.testing.assert_allclose(motion.poses_during(2, [0.21]), motion.poses_during(3, [-0.29]), atol=1e-11)


def test_a_longer_sequence_begins_with_the_same_bytes_and_a_seed_changes_disturbances_alone() -> None:
    moving = {"spin_rpm": [3.0, 8.0, 2.0], **ALL_THAT_ACTS}
    short = target_motion(scene_of(4, **moving), mass_of(), 7)
    long = target_motion(scene_of(9, horizon_s=5.0, **moving), mass_of(), 7)
    for name in ("r_N", "v_N", "R_NP", "w_P", "X_NG", "h_P"):
        np.testing.assert_array_equal(getattr(short, name), getattr(long, name)[:4])
    free: dict[str, Any] = {"spin_rpm": [0, 5, 1]}
    disturbed = {**free, "accel_psd": 1e-6}
    a, b = (target_motion(scene_of(4, **free), mass_of(), seed) for seed in (1, 2))
    np.testing.assert_array_equal(a.X_NG, b.X_NG)
    a, b = (target_motion(scene_of(4, **disturbed), mass_of(), seed) for seed in (1, 2))
    np.testing.assert_array_equal(a.R_NP, b.R_NP)
    assert np.abs(a.r_N[-1] - b.r_N[-1]).max() > 1e-5
