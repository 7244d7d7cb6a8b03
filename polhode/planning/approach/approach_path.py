"""A camera's path to the tumbling target, in N: it comes nearer along a line and looks at one point.

Two lines: towards the centre of mass, from where the camera is; or along the axis of a docking corridor, with
which the camera rotates. Both go from rest to rest relative to their line. The path says from where the
target would be seen. It does not minimize fuel, which ``trajectory`` does, and keeps clear of the target only
by the distance at which it ends.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, make_pose
from polhode.planning.approach.corridor import Corridor
from polhode.planning.prediction import BodyMotion

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
