"""Motion of the target over time: the truth of a sequence."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Ints, exp_so3, make_pose, matrix_from_wxyz, wxyz_from_matrix
from polhode.geometry.rigid_body import propagate
from polhode.simulation.motion.forces import acting_forces, is_free, momentum_of_rate
from polhode.simulation.motion.integrate import Forces, advance, body_rate, states_at
from polhode.simulation.motion.mass import MassDistribution

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
    h_P: Array
    """(T, 3) angular momentum, with friction including that of the ball inside [N m s]"""
    mass: MassDistribution
    forces: Forces

    @property
    def t_s(self) -> Array:
        """(T,) time after the first frame [s]."""
        return np.asarray((self.timestamps_ns - self.timestamps_ns[0]) / 1e9)

    def poses_during(self, k: int, offsets_s: ArrayLike) -> Array:
        """X_NG (S, 4, 4) at times (S,) after, or before, time k [s], under the same forces."""
        start_s = float(self.t_s[k])
        state = _state(self.r_N[k], self.v_N[k], self.R_NP[k], self.h_P[k])
        offsets = np.atleast_1d(np.asarray(offsets_s, dtype=np.float64))
        states = [advance(state, start_s, start_s + float(offset), self.forces) for offset in offsets]
        y = np.stack(states)
        return poses_of_target(y[:, :3], matrix_from_wxyz(y[:, 6:10]), self.mass)


def target_motion(scene: config.Scene, mass: MassDistribution, seed: int) -> TargetMotion:
    """Integrate the target over the frames and the horizon, under all forces and torques.

    The seed is that of the disturbances. Raises InputError for an impossible loss of energy.
    """
    start = scene.motion
    spin = np.array(start.spin_rpm) * RPM
    w_P = spin if start.spin_axes == "principal" else mass.R_GP.T @ spin
    R_NP = exp_so3(np.deg2rad(start.attitude_deg)) @ mass.R_GP
    v_N = np.array(start.velocity_mm_s) * 1e-3
    stamps = timestamps(scene)
    t_s = (stamps - stamps[0]) / 1e9
    forces = acting_forces(scene, mass, w_P, float(t_s[-1]), seed)
    if is_free(start):
        states = propagate(t_s, start.position_m, v_N, R_NP, w_P, np.diag(mass.moments))
        r_N_t, v_N_t, R_NP_t, w_P_t = states
        h_P_t = w_P_t * mass.moments
    else:
        h_P = momentum_of_rate(w_P, mass.moments, forces.friction)
        y = states_at(_state(np.array(start.position_m), v_N, R_NP, h_P), t_s, forces)
        r_N_t, v_N_t, R_NP_t, h_P_t = y[:, :3], y[:, 3:6], matrix_from_wxyz(y[:, 6:10]), y[:, 10:13]
        w_P_t = np.stack([body_rate(h, mass.moments, forces.friction) for h in h_P_t])
    X_NG = poses_of_target(r_N_t, R_NP_t, mass)
    return TargetMotion(stamps, r_N_t, v_N_t, R_NP_t, w_P_t, X_NG, h_P_t, mass, forces)


def timestamps(scene: config.Scene) -> Ints:
    """Times of the frames and of the truth beyond them (T,) [ns]."""
    extra = int(np.ceil(scene.truth_horizon_s / scene.interval_s - 1e-9))
    step_ns = round(scene.interval_s * 1e9)
    return scene.start_ns + step_ns * np.arange(scene.frames + extra, dtype=np.int64)


def poses_of_target(r_N: Array, R_NP: Array, mass: MassDistribution) -> Array:
    """X_NG (T, 4, 4) from the centre of mass (T, 3) [m] and the principal axes (T, 3, 3)."""
    R_NG = R_NP @ mass.R_GP.T
    return make_pose(R_NG, r_N - R_NG @ mass.com_G)


def _state(r_N: Array, v_N: Array, R_NP: Array, h_P: Array) -> Array:
    return np.concatenate([r_N, v_N, wxyz_from_matrix(R_NP), h_P])
