"""The target's motion and mass: conservation, MuJoCo, elliptic functions, frames that cancel."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.special import ellipj, ellipk, ellipkinc, elliprf, elliprj

from polhode.config import scene_settings as config
from polhode.config.loader import load_config
from polhode.geometry.lie import Array, exp_so3, log_so3, matrix_from_wxyz, transform_points
from polhode.geometry.rigid_body import angular_momentum_N, rotational_energy
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.dataset.sequence import SequencePlan, plan_sequence, truth_of
from polhode.simulation.motion.integrate import advance, no_forces
from polhode.simulation.motion.mass import MassDistribution, mass_distribution, principal_axes
from polhode.simulation.motion.target import TargetMotion, target_motion
from tests.simulation.motion.motion_scenes import TRIAXIAL, mass_of, rpm, scene_of

CONFIGS = Path(__file__).parents[3] / "configs"


ALL_THAT_ACTS: dict[str, Any] = {
    "accel_psd": 1e-6,
    "torque_psd": 1e-6,
    "energy_loss": 0.1,
    "energy_loss_by": "friction",
    "pushes": [
        {"start_s": 0.7, "duration_s": 2.0, "force_N": [0.01, 0.0, 0.0], "torque_P": [0.0, 1e-3, 0.0]},
        {"start_s": 0.0, "duration_s": 9.0, "torque_P": [1e-3, 0.0, 0.0]},
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
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 0" integrator="RK4" timestep="0.002"/><worldbody><body><freejoint/>
        <inertial pos="0 0 0" mass="4.487" diaginertia="{" ".join(map(repr, mass.moments.tolist()))}"/>
        </body></worldbody></mujoco>"""
    )
    data, quaternion = mujoco.MjData(model), np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, motion.R_NP[0].ravel())
    data.qpos[3:7], data.qvel[3:6] = quaternion, motion.w_P[0]
    mujoco.mj_step(model, data, nstep=30_000)
    error = log_so3(motion.R_NP[-1].T @ matrix_from_wxyz(data.qpos[3:7]))
    assert np.rad2deg(np.linalg.norm(error)) < 0.01


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


CASES = {
    "major axis": ([1.4, 1.0, 0.7], [1.0, 0.2, 0.3]),
    "minor axis": ([1.4, 1.0, 0.7], [0.1, -0.25, 1.1]),
    "minor axis, backwards": ([1.4, 1.0, 0.7], [0.2, 0.3, -1.2]),
    "flip above the separatrix": ([0.0241, 0.0234, 0.0201], [0.08, 1.04, 0.02]),
    "flip below the separatrix": ([0.0241, 0.0234, 0.0201], [0.02, 1.04, 0.08]),
    "oblate": ([1.7, 1.0, 1.0], [0.9, 0.3, -0.2]),
}


@pytest.mark.parametrize(("moments", "w_P"), CASES.values(), ids=CASES)
def test_attitude_agrees_with_the_elliptic_closed_form_after_a_minute(
    moments: list[float], w_P: list[float]
) -> None:
    J, w = np.array(moments), np.array(w_P)
    start_deg = [30.0, -50.0, 80.0]
    scene = scene_of(interval_s=20.0, horizon_s=60.0, spin_rpm=rpm(w), attitude_deg=start_deg)
    motion = target_motion(scene, mass_of(J), 0)
    np.testing.assert_array_equal(motion.t_s, [0.0, 20.0, 40.0, 60.0])
    for k, t_s in enumerate(motion.t_s):
        R_NP, w_P_t = closed_form(J, exp_so3(np.deg2rad(start_deg)), w, float(t_s))
        np.testing.assert_allclose(motion.w_P[k], w_P_t, atol=1e-9)
        assert np.rad2deg(np.linalg.norm(log_so3(motion.R_NP[k].T @ R_NP))) < 1e-6


def test_the_integrator_under_forces_agrees_with_it_too() -> None:
    J, w = (np.array(values) for values in CASES["flip above the separatrix"])
    y = advance(np.concatenate([np.zeros(6), [1, 0, 0, 0], J * w]), 0.0, 60.0, no_forces(J))
    R_NP, w_P = closed_form(J, np.eye(3), w, 60.0)
    np.testing.assert_allclose(y[10:13] / J, w_P, atol=1e-10)
    # First column of the rotation matrix, written out of the quaternion.
    a, b, c, d = y[6:10]
    column = [a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c)]
    np.testing.assert_allclose(column, R_NP[:, 0], atol=1e-9)


def closed_form(J: Array, R_NP0: Array, w_P0: Array, t_s: float) -> tuple[Array, Array]:
    """R_NP (3, 3) and w_P (3,) at a time t_s from those at zero; moments (3,) sorted, greatest first."""
    R_PA = _axes_of_circulation(J, w_P0)
    J_A, w_A0 = np.diag(R_PA.T @ np.diag(J) @ R_PA), R_PA.T @ w_P0
    h = float(np.linalg.norm(J_A * w_A0))
    w_A, turn = _rate_and_precession(J_A, w_A0, h, t_s)
    R_HA0, R_HA = _momentum_upwards(J_A * w_A0 / h), _momentum_upwards(J_A * w_A / h)
    about_h = exp_so3([0.0, 0.0, turn])
    R_NA = R_NP0 @ R_PA @ R_HA0.T @ about_h @ R_HA
    return R_NA @ R_PA.T, R_PA @ w_A


def _axes_of_circulation(J: Array, w_P: Array) -> Array:
    """R_PA: A's third axis is the principal axis that w circles, and w is on its positive side."""
    two_energy, h_squared = float(J @ w_P**2), float(np.sum((J * w_P) ** 2))
    about_major = h_squared > two_energy * J[1]
    R_PA = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]) if about_major else np.eye(3)
    return R_PA @ np.diag([1.0, -1.0, -1.0]) if (R_PA.T @ w_P)[2] < 0 else R_PA


def _rate_and_precession(J: Array, w0: Array, h: float, t_s: float) -> tuple[Array, float]:
    """Angular velocity in A after t_s, and the angle by which the third axis has turned about h."""
    J1, J2, J3 = J
    two_energy = float(J @ w0**2)
    d3, d1 = two_energy * J3 - h**2, h**2 - two_energy * J1
    amplitude = np.sqrt(np.array([d3 / (J1 * (J3 - J1)), d3 / (J2 * (J3 - J2)), d1 / (J3 * (J3 - J1))]))
    rate = np.sqrt((J3 - J2) * d1 / (J1 * J2 * J3))
    m = (J2 - J1) * d3 / ((J3 - J2) * d1)
    sign = np.sign(J3 - J2)
    phase = float(np.arctan2(sign * w0[1] / amplitude[1], w0[0] / amplitude[0]))
    sn, cn, dn, amplitude_angle = ellipj(ellipkinc(phase, m) + rate * t_s, m)
    w = amplitude * np.array([cn, sign * sn, dn])
    # phi' = h/J3 + h (2E - h^2/J3) / (h^2 - J3^2 w3^2), and w3^2 falls with sn^2.
    across = h**2 - (J3 * amplitude[2]) ** 2
    n = -m * (J3 * amplitude[2]) ** 2 / across
    swept = _third_kind(n, float(amplitude_angle), m) - _third_kind(n, phase, m)
    return w, float(h * t_s / J3 + h * (two_energy - h**2 / J3) / (across * rate) * swept)


def _third_kind(n: float, angle: float, m: float) -> float:
    """Incomplete elliptic integral of the third kind, any angle, n <= 0: Carlson's forms (DLMF 19.25.14)."""
    turns = np.round(angle / np.pi)
    rest = angle - turns * np.pi
    s, c = np.sin(rest), np.cos(rest)
    y = 1 - m * s * s
    partial = s * elliprf(c * c, y, 1.0) + n / 3 * s**3 * elliprj(c * c, y, 1.0, 1 - n * s * s)
    complete = ellipk(m) + n / 3 * elliprj(0.0, 1 - m, 1.0, 1 - n)
    return float(partial + 2 * turns * complete)


def _momentum_upwards(h_A: Array) -> Array:
    """R_HA: third axis of H along h (3,) unit, A's third axis in the plane of H's first and third."""
    axis = np.array([0.0, 0.0, 1.0])
    first = axis - h_A * (h_A @ axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(h_A, first), h_A])


@pytest.fixture(scope="module")
def flyer() -> Body:
    return build_body(config.TargetBody(), 0)


def test_densities_and_mass_give_the_mass_properties(flyer: Body) -> None:
    mass = mass_distribution(config.Mass(density_kg_m3=500.0), flyer)
    assert mass.mass_kg == pytest.approx(500.0 * flyer.volume_m3)
    np.testing.assert_allclose(mass.com_G, flyer.com_G, atol=1e-15)
    np.testing.assert_allclose(mass.J_G, 500.0 * flyer.inertia_per_density, atol=1e-12)
    by_density = mass_distribution(config.Mass(part_density_kg_m3={"tank": 4000.0}), flyer)
    by_hand = mass_distribution(config.Mass(part_density_kg_m3={"tank": 4000.0}, mass_kg=4.487), flyer)
    assert by_hand.mass_kg == pytest.approx(4.487)
    np.testing.assert_allclose(by_hand.J_G, by_density.J_G * 4.487 / by_density.mass_kg, rtol=1e-12)
    np.testing.assert_allclose(by_hand.com_G, by_density.com_G, atol=1e-15)
    inertia = ((3e-2, 1e-4, 0.0), (1e-4, 2e-2, 0.0), (0.0, 0.0, 2.5e-2))
    mass = mass_distribution(config.Mass(com_m=(1e-3, 2e-3, 3e-3), inertia_kg_m2=inertia, mass_kg=7.0), flyer)
    np.testing.assert_array_equal(mass.com_G, [1e-3, 2e-3, 3e-3])
    np.testing.assert_array_equal(mass.J_G, inertia)
    assert mass.mass_kg == pytest.approx(7.0)


def test_a_part_of_its_own_density_adds_its_own_mass(flyer: Body) -> None:
    """The tank made 5000 kg/m^3 denser: mass, first and second moments grow by those of the tank alone."""
    (tank,) = [part for part in flyer.parts if part.name == "tank"]
    density = 1000.0 * tank.density_factor
    light = mass_distribution(config.Mass(part_density_kg_m3={"tank": density}), flyer)
    heavy = mass_distribution(config.Mass(part_density_kg_m3={"tank": density + 5000.0}), flyer)
    np.testing.assert_allclose(light.J_G, mass_distribution(config.Mass(), flyer).J_G, rtol=1e-12)
    added_kg = 5000.0 * tank.volume_m3
    assert heavy.mass_kg - light.mass_kg == pytest.approx(added_kg)
    first = heavy.mass_kg * heavy.com_G - light.mass_kg * light.com_G
    np.testing.assert_allclose(first, added_kg * tank.com_G, atol=1e-15)
    second = _about_origin(heavy.J_G, heavy.mass_kg, heavy.com_G) - _about_origin(
        light.J_G, light.mass_kg, light.com_G
    )
    expected = _about_origin(5000.0 * tank.inertia_per_density, added_kg, tank.com_G)
    np.testing.assert_allclose(second, expected, atol=1e-15)


def _about_origin(J_G: np.ndarray, mass_kg: float, com_G: np.ndarray) -> np.ndarray:
    return np.asarray(J_G + mass_kg * (com_G @ com_G * np.eye(3) - np.outer(com_G, com_G)))


def test_an_unknown_part_and_an_impossible_inertia_are_refused(flyer: Body) -> None:
    with pytest.raises(InputError, match=r"part_density_kg_m3: the body has no part 'wing', only .*tank"):
        mass_distribution(config.Mass(part_density_kg_m3={"wing": 1.0}), flyer)
    mass = config.Mass(com_m=(0, 0, 0), inertia_kg_m2=((3, 0, 0), (0, 1, 0), (0, 0, 1)))
    with pytest.raises(InputError, match="no body has the principal moments 1, 1, 3"):
        mass_distribution(mass, flyer)
    mass = config.Mass(inertia_kg_m2=((3, 0.1, 0), (0, 2, 0), (0, 0, 2)))
    with pytest.raises(InputError, match="not symmetric"):
        mass_distribution(mass, flyer)


@pytest.mark.parametrize("seed", range(2))
def test_principal_axes_are_sorted_and_right_handed(seed: int) -> None:
    A = np.random.default_rng(seed).normal(size=(3, 3))
    J = A @ A.T
    moments, R = principal_axes(J)
    assert moments[0] >= moments[1] >= moments[2]
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ np.diag(moments) @ R.T, J, atol=1e-12)


PATHS = [
    CONFIGS / "ts38.yaml",
    *(CONFIGS / f"scenes/{name}.yaml" for name in ("flat_spin", "known_torque", "axisymmetric")),
]


@pytest.fixture(scope="module", params=PATHS, ids=lambda path: path.stem)
def planned(request: pytest.FixtureRequest) -> SequencePlan:
    config = load_config(request.param)
    assert config.scene is not None
    return plan_sequence(config.scene, config.seed)


def _finely(planned: SequencePlan, step_s: float) -> TargetMotion:
    fine = planned.scene.model_copy(update={"frames": 201, "interval_s": step_s, "truth_horizon_s": 0.0})
    return target_motion(fine, planned.mass, planned.seed)


def test_velocities_are_the_derivatives_of_position_and_attitude(planned: SequencePlan) -> None:
    motion = _finely(planned, 0.01)
    slope = (motion.r_N[2:] - motion.r_N[:-2]) / 0.02
    np.testing.assert_allclose(slope, motion.v_N[1:-1], atol=1e-11)
    motion = _finely(planned, 0.002)
    turn = log_so3(np.swapaxes(motion.R_NP[:-2], 1, 2) @ motion.R_NP[2:]) / 0.004
    # Central difference: the error is of second order in the step, (w dt)^2 |w| / 6 at most.
    assert np.abs(turn - motion.w_P[1:-1]).max() < 5e-6


def test_truth_is_sorted_right_handed_and_continues_a_minute(planned: SequencePlan) -> None:
    truth = truth_of(planned)
    assert truth.moments[0] >= truth.moments[1] >= truth.moments[2] > 0
    assert truth.moments[0] <= truth.moments[1] + truth.moments[2]
    assert np.linalg.det(truth.R_GP) == pytest.approx(1.0)
    J_G = truth.R_GP @ np.diag(truth.moments) @ truth.R_GP.T
    np.testing.assert_allclose(J_G, planned.mass.J_G, atol=1e-12 * truth.moments[0])
    assert truth.k1 == pytest.approx(np.log(truth.moments[0] / truth.moments[1]))
    assert truth.k2 == pytest.approx(np.log(truth.moments[1] / truth.moments[2]))
    last_image_ns = truth.timestamps_ns[planned.scene.frames - 1]
    assert truth.timestamps_ns[-1] - last_image_ns == 60_000_000_000
