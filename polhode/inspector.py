"""Where the inspector was: ``inspector0/`` of a sequence, at the times of the frames."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from polhode.errors import InputError
from polhode.lie import Array, make_pose
from polhode.quaternion import matrix_from_wxyz
from polhode.records import Ints
from polhode.tables import numbers_at, numbers_of, read_mapping, read_rows, timestamps_of

UNIT_TOLERANCE = 1e-2
SAME_POSITION_M = 1e-9
SAME_ROTATION = 1e-9


@dataclass(frozen=True)
class InspectorPoses:
    """Pose of the inspector's body B in N at each frame, and how well it is known."""

    X_NB: Array
    """(F, 4, 4)"""
    sigma_p_m: float
    sigma_theta_rad: float
    moves: bool
    warnings: tuple[str, ...]


def read_inspector(folder: Path, timestamps_ns: Ints) -> InspectorPoses:
    """Read ``inspector0`` and interpolate it to the frames (F,): linear in position, slerp in attitude.

    Raises InputError when the poses hold NaN, a quaternion is not of unit length, or a frame has no pose
    within one interval between frames.
    """
    path = folder / "data.csv"
    rows = read_rows(path)
    stamps = timestamps_of(path, rows)
    values = numbers_of(path, rows, columns=7)
    norm = np.linalg.norm(values[:, 3:], axis=1)
    if (abs(norm - 1.0) > UNIT_TOLERANCE).any():
        number = rows[int(np.argmax(abs(norm - 1.0)))][0]
        raise InputError(f"{path} line {number}: q_RS (w, x, y, z) is not a unit quaternion")
    interpolated = _require_cover(path, stamps, timestamps_ns)
    sigma_p_m, sigma_theta_rad, warnings = _read_sigmas(folder / "sensor.yaml")
    X_NB = _interpolate(stamps, values, timestamps_ns)
    if interpolated:
        warnings = (*warnings, f"{path}: {interpolated} frames lack a pose of their own; it was interpolated")
    moved = np.abs(X_NB - X_NB[0])
    moves = bool(moved[:, :3, 3].max() > SAME_POSITION_M or moved[:, :3, :3].max() > SAME_ROTATION)
    return InspectorPoses(X_NB, sigma_p_m, sigma_theta_rad, moves, warnings)


def _require_cover(path: Path, stamps: Ints, frames: Ints) -> int:
    """Raise unless each frame has a pose within one frame interval; count those far from any pose."""
    interval_ns = float(np.median(np.diff(frames)))
    after = np.clip(np.searchsorted(stamps, frames), 0, len(stamps) - 1)
    before = np.clip(after - 1, 0, len(stamps) - 1)
    distance = np.minimum(abs(stamps[after] - frames), abs(stamps[before] - frames))
    far = distance > interval_ns * 1.001
    if far.any():
        message = f"{path} does not cover {int(far.sum())} of {len(frames)} frames, first {frames[far][0]} ns"
        raise InputError(f"{message}; give a pose for every frame, or remove inspector0/ if it is at rest")
    return int((distance > 0.5 * interval_ns).sum())


def _read_sigmas(path: Path) -> tuple[float, float, tuple[str, ...]]:
    """sigma_p_m, sigma_theta_rad; a file or key that is absent means that the poses are exact."""
    if not path.exists() or not path.read_bytes().strip():
        return 0.0, 0.0, ()
    sensor = read_mapping(
        path, "give sigma_p_m and sigma_theta_rad, or remove the file if the poses are exact"
    )
    sigmas = []
    for key in ("sigma_p_m", "sigma_theta_rad"):
        sigma = float(numbers_at(path, sensor, key, (1,))[0]) if key in sensor else 0.0
        if sigma < 0.0:
            raise InputError(f"{path} key '{key}': {sigma:g} is negative; a standard deviation is not")
        sigmas.append(sigma)
    warnings: tuple[str, ...] = ()
    if "T_BS" in sensor and not np.allclose(numbers_at(path, sensor, "T_BS", (16,)), np.eye(4).ravel()):
        warnings = (
            f"{path}: T_BS is not applied; data.csv must hold the pose of the body B that cameras refer to",
        )
    return sigmas[0], sigmas[1], warnings


def _interpolate(stamps: Ints, values: Array, frames: Ints) -> Array:
    """Poses (F, 4, 4) at the frames; outside the first and last pose the nearest one holds."""
    R = matrix_from_wxyz(values[:, 3:])
    if len(stamps) == 1:
        return np.repeat(make_pose(R, values[:, :3]), len(frames), axis=0)
    # Differences in int64 first: nanoseconds since 1970 do not fit the 53 bits of a double.
    t_poses = (stamps - stamps[0]).astype(np.float64)
    t_frames = np.clip((frames - stamps[0]).astype(np.float64), t_poses[0], t_poses[-1])
    p_N = np.stack([np.interp(t_frames, t_poses, values[:, k]) for k in range(3)], axis=-1)
    return make_pose(Slerp(t_poses, Rotation.from_matrix(R))(t_frames).as_matrix(), p_N)
