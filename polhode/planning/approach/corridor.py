"""The approach corridor of a docking point, the cost of staying in, and a camera's path to the target.

The corridor is the docking axis, which rotates with the target. An inspector at a fixed stand-off along it
moves with the target: besides the motion of the centre of mass, which is free, it needs the acceleration
dw/dt x r + w x (w x r), r from the centre of mass (Euler and centripetal terms; thesis eq. 1.1 has the second
one alone).

The path comes nearer along a line and looks at one point: towards the centre of mass, from where the camera
is; or along the axis of a docking corridor, with which the camera rotates. Both go from rest to rest relative
to their line. The path says from where the target would be seen. It does not minimize fuel, which
``trajectory`` does, and keeps clear of the target only by the distance at which it ends.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, make_pose
from polhode.planning.prediction import BodyMotion


@dataclass(frozen=True)
class Corridor:
    """The docking axis and an inspector at the stand-off, at T instants, in N."""

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

    @property
    def delta_v_m_s(self) -> float:
        """Change of velocity over the whole time, by the trapezoidal rule."""
        return float(np.trapezoid(np.linalg.norm(self.acceleration_N, axis=1), self.time_s))


def corridor(motion: BodyMotion, point_G: Array, axis_G: Array, stand_off_m: float) -> Corridor:
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
    )


POSES = 61


@dataclass(frozen=True)
class ApproachPath:
    """Poses of a camera that looks along its z axis, x right, y down."""

    time_s: Array
    """(K,) after the last pair, from 0 to the horizon"""
    X_NR: Array
    """(K, 4, 4)"""
    distance_m: Array
    """(K,) from the point that it looks at"""


def towards_centre(motion: BodyMotion, X_NR: Array, end_m: float) -> ApproachPath:
    """From the camera's last pose X_NR (4, 4) to ``end_m`` from the centre of mass, a direction fixed in N.

    A camera that is nearer keeps its distance.
    """
    away = X_NR[:3, 3] - motion.com_N[0]
    start_m = float(np.linalg.norm(away))
    distance_m = _from_rest_to_rest(motion.time_s, start_m, min(end_m, start_m))
    place_N = motion.com_N + distance_m[:, None] * (away / start_m)
    down_N = np.tile(X_NR[:3, 1], (len(place_N), 1))
    return ApproachPath(motion.time_s, _looking_at(motion.com_N, place_N, down_N), distance_m)


def along_corridor(motion: BodyMotion, corridor: Corridor, X_NR: Array, stand_off_m: float) -> ApproachPath:
    """Along the corridor's axis to the stand-off, from as far as the camera's last pose X_NR (4, 4) is.

    ``corridor`` is that of the motion. The camera is at rest relative to the target but for its approach.
    """
    start_m = max(float(np.linalg.norm(X_NR[:3, 3] - corridor.tip_N[0])), stand_off_m)
    distance_m = _from_rest_to_rest(motion.time_s, start_m, stand_off_m)
    place_N = corridor.tip_N + distance_m[:, None] * corridor.axis_N
    # any direction that is fixed to the target and not along the axis
    axis_G = motion.R_NG[0].T @ corridor.axis_N[0]
    down_N = motion.R_NG @ np.eye(3)[int(np.argmin(np.abs(axis_G)))]
    return ApproachPath(motion.time_s, _looking_at(corridor.tip_N, place_N, down_N), distance_m)


def _from_rest_to_rest(time_s: Array, start_m: float, end_m: float) -> Array:
    """(K,) distances whose rate is zero at both ends: the cubic."""
    s = time_s / time_s[-1]
    return np.asarray(start_m + (end_m - start_m) * s * s * (3.0 - 2.0 * s))


def _looking_at(point_N: Array, place_N: Array, down_N: Array) -> Array:
    """Poses (K, 4, 4) of cameras at place_N (K, 3): z towards point_N (K, 3), y near to down_N (K, 3)."""
    z = point_N - place_N
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross(down_N, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return make_pose(np.stack([x, np.cross(z, x), z], axis=-1), place_N)
