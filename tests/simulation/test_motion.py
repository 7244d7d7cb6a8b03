"""Truth: conservation laws, agreement with MuJoCo, frames that cancel."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from polhode.config import scene as config
from polhode.config.loader import load_config
from polhode.errors import InputError
from polhode.lie import Array, log_so3, transform_points
from polhode.quaternion import matrix_from_wxyz
from polhode.rigid_body import angular_momentum_N, rotational_energy
from simulation.bodies import build_body
from simulation.motion import (
    MassDistribution,
    camera_motion,
    mass_distribution,
    principal_axes,
    reported_inspector,
    target_motion,
)

CONFIGS = Path(__file__).parents[2] / "configs"
TS38 = load_config(CONFIGS / "ts38.yaml").scene


def _scene(**changes: object) -> config.Scene:
    assert TS38 is not None
    return TS38.model_copy(update=changes)


def _mass(scene: config.Scene) -> MassDistribution:
    """Mass properties set by hand, which need no body."""
    assert scene.mass.inertia_kg_m2 is not None
    J_G = np.array(scene.mass.inertia_kg_m2)
    return MassDistribution(np.array(scene.mass.com_m), J_G, *principal_axes(J_G), 4.487)


def test_energy_and_momentum_are_constant_over_ten_minutes() -> None:
    scene = _scene(frames=1, interval_s=5.0, truth_horizon_s=600.0)
    mass = _mass(scene)
    motion = target_motion(scene, mass, 0)
    J_P = np.diag(mass.moments)
    energy = rotational_energy(J_P, motion.w_P)
    momentum = angular_momentum_N(J_P, motion.R_NP, motion.w_P)
    assert np.abs(energy / energy[0] - 1).max() < 1e-9
    assert np.linalg.norm(momentum - momentum[0], axis=1).max() < 1e-9 * np.linalg.norm(momentum[0])
    np.testing.assert_allclose(motion.v_N, np.broadcast_to(motion.v_N[0], motion.v_N.shape), rtol=1e-12)


def test_the_attitude_agrees_with_mujoco_after_a_minute() -> None:
    scene = _scene(frames=1, interval_s=60.0, truth_horizon_s=60.0)
    mass = _mass(scene)
    motion = target_motion(scene, mass, 0)
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


def test_the_thesis_session_flips_about_its_intermediate_axis() -> None:
    scene = _scene(truth_horizon_s=0.0)
    w_y_rpm = target_motion(scene, _mass(scene), 0).w_P[:, 1] * 60 / (2 * np.pi)
    assert w_y_rpm[0] > 9.9
    assert w_y_rpm[-1] < 0.0


def test_the_thesis_inertia_gives_its_published_principal_axes() -> None:
    mass = _mass(_scene())
    np.testing.assert_allclose(mass.moments, [0.0241, 0.0234, 0.0201], atol=5e-5)
    published = np.array([[0.9833, 0.1787, 0.0349], [-0.1783, 0.9838, -0.0160], [-0.0372, 0.0095, 0.9993]])
    np.testing.assert_allclose(mass.R_GP, published, atol=1e-4)


def test_centre_of_mass_in_G_maps_to_its_position_in_N() -> None:
    scene = _scene(frames=5, truth_horizon_s=2.0)
    mass = _mass(scene)
    motion = target_motion(scene, mass, 0)
    np.testing.assert_allclose(transform_points(motion.X_NG, mass.com_G[None])[:, 0], motion.r_N, atol=1e-15)
    np.testing.assert_allclose(motion.X_NG[:, :3, :3] @ mass.R_GP, motion.R_NP, atol=1e-14)


def test_truth_goes_on_past_the_last_frame_at_the_frame_interval() -> None:
    scene = _scene(frames=10, interval_s=0.5, truth_horizon_s=60.0)
    stamps = target_motion(scene, _mass(scene), 0).timestamps_ns
    assert len(stamps) == 130
    assert set(np.diff(stamps)) == {500_000_000}


@pytest.mark.parametrize("seed", range(5))
def test_principal_axes_are_sorted_and_right_handed(seed: int) -> None:
    A = np.random.default_rng(seed).normal(size=(3, 3))
    J = A @ A.T
    moments, R = principal_axes(J)
    assert moments[0] >= moments[1] >= moments[2]
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ np.diag(moments) @ R.T, J, atol=1e-12)


def test_an_impossible_inertia_is_refused() -> None:
    mass = config.Mass(com_m=(0, 0, 0), inertia_kg_m2=((3, 0, 0), (0, 1, 0), (0, 0, 1)))
    with pytest.raises(InputError, match="no body has the principal moments 1, 1, 3"):
        mass_distribution(mass, build_body(config.Body(), 0))


def test_a_circling_camera_keeps_facing_the_target_at_a_constant_distance() -> None:
    inspector = config.Inspector(profile="circle", circle_period_s=40.0)
    scene = _scene(frames=20, inspector=inspector, motion=config.Motion(position_m=(0, 0, 0.6)))
    for X_NC in camera_motion(scene):
        p_C = X_NC[:3, :3].T @ (np.array([0, 0, 0.6]) - X_NC[:3, 3])
        np.testing.assert_allclose(p_C, [0, 0, 0.6], atol=1e-12)


def test_reported_poses_scatter_as_the_scene_says() -> None:
    inspector = config.Inspector(profile="drift", sigma_p_m=1e-3, sigma_theta_deg=0.1)
    scene = _scene(frames=2000, inspector=inspector)
    X_NC = camera_motion(scene)
    reported = reported_inspector(scene, X_NC, np.eye(4), np.random.default_rng(0))
    assert (reported[:, :3, 3] - X_NC[:, :3, 3]).std() == pytest.approx(1e-3, rel=0.05)
    theta = log_so3(np.swapaxes(X_NC[:, :3, :3], 1, 2) @ reported[:, :3, :3])
    assert np.rad2deg(theta).std() == pytest.approx(0.1, rel=0.05)
