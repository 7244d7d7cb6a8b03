"""A trajectory as a TUM file: ``timestamp tx ty tz qx qy qz qw``, one pose of the camera a line."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.errors import InputError
from polhode.lie import Array, make_pose
from polhode.quaternion import matrix_from_wxyz

UNIT_WITHIN = 1e-2
"""How far a quaternion's length may be from 1."""
MOST = 1e12
"""Largest coordinate of a place [m]."""


@dataclass(frozen=True)
class TimedPoses:
    """Poses of the camera in a frame F that the user names."""

    time_s: Array
    """(k,) increasing"""
    X_FR: Array
    """(k, 4, 4)"""


def read_poses(path: Path) -> TimedPoses:
    """Raises InputError, one line, for anything that is no such file."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file of poses") from error
    rows = [_row(path, number, line) for number, line in enumerate(lines, 1) if _says_something(line)]
    if not rows:
        raise InputError(f"{path}: holds no pose; a line is: timestamp tx ty tz qx qy qz qw")
    table = np.array(rows)
    if not (np.diff(table[:, 0]) > 0.0).all():
        late = 1 + int(np.argmax(np.diff(table[:, 0]) <= 0.0))
        raise InputError(f"{path}: pose {late + 1} is not later than the one before")
    if (np.abs(table[:, 1:]) > MOST).any():
        raise InputError(f"{path}: holds a place or quaternion above {MOST:g}")
    length = np.linalg.norm(table[:, 4:], axis=1)
    if (np.abs(length - 1.0) > UNIT_WITHIN).any():
        bad = int(np.argmax(np.abs(length - 1.0)))
        raise InputError(f"{path}: the quaternion of pose {bad + 1} has length {length[bad]:.3g}, not 1")
    wxyz = table[:, [7, 4, 5, 6]] / length[:, None]
    return TimedPoses(table[:, 0], make_pose(matrix_from_wxyz(wxyz), table[:, 1:4]))


def _says_something(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _row(path: Path, number: int, line: str) -> list[float]:
    words = line.replace(",", " ").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != 8 or not np.isfinite(values).all():
        raise InputError(f"{path}, line {number}: give eight numbers: timestamp tx ty tz qx qy qz qw")
    return values
