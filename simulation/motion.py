"""Motion of target and inspector over time: the truth of a sequence."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from polhode.config import scene as config
from polhode.errors import InputError
from polhode.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.records import Ints
from polhode.rigid_body import propagate
from simulation.bodies import Body

RPM = 2.0 * np.pi / 60.0


@dataclass(frozen=True)
class MassDistribution:
    """Mass properties in G; principal moments sorted, greatest first."""

    com_G: Array
    """(3,) [m]"""
    J_G: Array
    """(3, 3) about the centre of mass, axes of G [kg m^2]"""
    moments: Array
    """(3,) [kg m^2]"""
    R_GP: Array
    """(3, 3) right-handed"""


@dataclass(frozen=True)
class TargetMotion:
    """States of the target at T times: the frames first, then the horizon."""

    timestamps_ns: Ints
    """(T,)"""
    r_N: Array
    """(T, 3) [m]"""
    v_N: Array
    """(T, 3) [m/s]"""
    R_NP: Array
    """(T, 3, 3)"""
    w_P: Array
    """(T, 3) [rad/s]"""
    X_NG: Array
    """(T, 4, 4)"""


def mass_distribution(mass: config.Mass, body: Body) -> MassDistribution:
    """Mass properties by hand or by uniform density. Raises InputError for an impossible inertia."""
    com_G = body.com_G if mass.com_m is None else np.array(mass.com_m)
    if mass.inertia_kg_m2 is None:
        J_G = mass.density_kg_m3 * body.inertia_per_density
    else:
        J_G = np.array(mass.inertia_kg_m2)
        _require_physical(J_G)
    moments, R_GP = principal_axes(J_G)
    return MassDistribution(com_G, J_G, moments, R_GP)


def principal_axes(J: ArrayLike) -> tuple[Array, Array]:
    """Inertia (3, 3) -> moments (3,) sorted from the greatest, R_GP (3, 3) right-handed.

    Of the four choices of half-turn, the one whose axes lie closest to those of G.
    """
    values, vectors = np.linalg.eigh(np.asarray(J, dtype=np.float64))
    R = vectors[:, ::-1] * np.sign(np.linalg.det(vectors[:, ::-1]))
    turns = [np.diag(d) for d in ([1.0, 1, 1], [1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])]
    R_GP = max((R @ turn for turn in turns), key=lambda candidate: float(np.trace(candidate)))
    return values[::-1].copy(), R_GP


def _require_physical(J: Array) -> None:
    if not np.allclose(J, J.T, rtol=0, atol=1e-9 * np.abs(J).max()):
        raise InputError("scene.mass.inertia_kg_m2 is not symmetric: give the full 3x3 matrix")
    low, middle, high = np.linalg.eigvalsh(J)
    if low <= 0 or low + middle < high * (1 - 1e-9):
        raise InputError(
            f"scene.mass.inertia_kg_m2: no body has the principal moments {low:.4g}, {middle:.4g}, "
            f"{high:.4g}; they must be positive and the greatest at most the sum of the others"
        )


def timestamps(scene: config.Scene) -> Ints:
    """Times of the frames and of the truth beyond them (T,) [ns]."""
    extra = int(np.ceil(scene.truth_horizon_s / scene.interval_s - 1e-9))
    step_ns = round(scene.interval_s * 1e9)
    return scene.start_ns + step_ns * np.arange(scene.frames + extra, dtype=np.int64)


def target_motion(scene: config.Scene, mass: MassDistribution) -> TargetMotion:
    """Integrate the torque-free target over the frames and the horizon."""
    start = scene.motion
    R_NG = exp_so3(np.deg2rad(start.attitude_deg))
    spin = np.array(start.spin_rpm) * RPM
    w_P = spin if start.spin_axes == "principal" else mass.R_GP.T @ spin
    stamps = timestamps(scene)
    t_s = (stamps - stamps[0]) * 1e-9
    r_N, v_N, R_NP, w_P_t = propagate(
        t_s,
        start.position_m,
        np.array(start.velocity_mm_s) * 1e-3,
        R_NG @ mass.R_GP,
        w_P,
        np.diag(mass.moments),
    )
    R_NG_t = R_NP @ mass.R_GP.T
    return TargetMotion(stamps, r_N, v_N, R_NP, w_P_t, make_pose(R_NG_t, r_N - R_NG_t @ mass.com_G))


def camera_motion(scene: config.Scene) -> Array:
    """Poses X_NC (F, 4, 4) of the left camera at the frames."""
    inspector = scene.inspector
    t_s = scene.interval_s * np.arange(scene.frames)
    X_NC0 = make_pose(exp_so3(np.deg2rad(inspector.attitude_deg)), inspector.position_m)
    match inspector.profile:
        case "rest":
            return np.repeat(X_NC0[None], scene.frames, axis=0)
        case "drift":
            R = X_NC0[:3, :3] @ exp_so3(t_s[:, None] * np.deg2rad(inspector.rate_deg_s))
            return make_pose(R, X_NC0[:3, 3] + t_s[:, None] * np.array(inspector.velocity_mm_s) * 1e-3)
        case "circle":
            axis = np.array(inspector.circle_axis) / np.linalg.norm(inspector.circle_axis)
            turn = exp_so3(t_s[:, None] * (2 * np.pi / inspector.circle_period_s) * axis)
            centre_N = np.array(scene.motion.position_m)
            about_centre = make_pose(turn, centre_N - turn @ centre_N)
            return np.asarray(about_centre @ X_NC0)


def reported_inspector(scene: config.Scene, X_NC: Array, X_BC: Array, rng: np.random.Generator) -> Array:
    """Inspector poses X_NB (F, 4, 4) as its own estimator reports them: truth plus noise."""
    X_NB = X_NC @ inverse_pose(X_BC)
    noise_p_N = rng.normal(0.0, 1.0, (len(X_NB), 3)) * scene.inspector.sigma_p_m
    noise_theta = rng.normal(0.0, 1.0, (len(X_NB), 3)) * np.deg2rad(scene.inspector.sigma_theta_deg)
    return make_pose(X_NB[:, :3, :3] @ exp_so3(noise_theta), X_NB[:, :3, 3] + noise_p_N)
