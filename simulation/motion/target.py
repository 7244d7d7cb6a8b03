"""Motion of the target over time: the truth of a sequence."""

from dataclasses import dataclass

import numpy as np

from polhode.config import scene as config
from polhode.lie import Array, exp_so3, make_pose
from polhode.records import Ints
from polhode.rigid_body import propagate
from simulation.motion.mass import MassDistribution

RPM = 2.0 * np.pi / 60.0


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
