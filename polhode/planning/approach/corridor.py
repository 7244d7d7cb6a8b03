"""The approach corridor of a docking point: a cone that rotates with the target, and the cost of staying in.

An inspector at a fixed stand-off in the corridor moves with the target: besides the motion of the centre of
mass, which is free, it needs the acceleration dw/dt x r + w x (w x r), r from the centre of mass (Euler and
centripetal terms; thesis eq. 1.1 has the second one alone).
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array
from polhode.planning.prediction import BodyMotion


@dataclass(frozen=True)
class Corridor:
    """The cone and an inspector at the stand-off, at T instants, in N."""

    time_s: Array
    tip_N: Array
    """(T, 3) docking point [m]"""
    axis_N: Array
    """(T, 3) unit vector outwards"""
    place_N: Array
    """(T, 3) position of the inspector [m]"""
    velocity_N: Array
    """(T, 3) [m/s]"""
    acceleration_N: Array
    """(T, 3) [m/s^2]"""
    half_angle_rad: float

    @property
    def delta_v_m_s(self) -> float:
        """Change of velocity over the whole time, by the trapezoidal rule."""
        return float(np.trapezoid(np.linalg.norm(self.acceleration_N, axis=1), self.time_s))

    def angle_rad(self, p_N: Array) -> Array:
        """(T,) angle from the axis to the line from the docking point to p_N (T, 3), or (3,) at rest in N."""
        offset = p_N - self.tip_N
        along = np.einsum("ti,ti->t", offset, self.axis_N)
        across = np.linalg.norm(np.cross(offset, self.axis_N), axis=1)
        return np.asarray(np.arctan2(across, along))

    def contains(self, p_N: Array) -> Array:
        """(T,) whether a point (T, 3) at each instant, or (3,) at rest in N, lies in the cone."""
        return np.asarray(self.angle_rad(p_N) <= self.half_angle_rad)


def corridor(
    motion: BodyMotion, point_G: Array, axis_G: Array, stand_off_m: float, half_angle_rad: float
) -> Corridor:
    """point_G (3,) [m]; axis_G (3,) any length, outwards."""
    axis_N = motion.R_NG @ (axis_G / np.linalg.norm(axis_G))
    tip_N = motion.R_NG @ point_G + motion.p_NG
    place_N = tip_N + stand_off_m * axis_N
    r, w = place_N - motion.com_N, motion.w_N
    turning = np.cross(w, r)
    return Corridor(
        motion.time_s,
        tip_N,
        axis_N,
        place_N,
        motion.v_N + turning,
        np.cross(motion.w_dot_N, r) + np.cross(w, turning),
        half_angle_rad,
    )
