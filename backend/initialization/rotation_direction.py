"""Direction of rotation between frames: near half a revolution, poses alone do not determine it.

A rotation by 200 degrees leads to the same attitude as one by 160 degrees in the opposite direction. Euler's
equation distinguishes the two if the axis of rotation moves in the body; otherwise both fit.
"""

import numpy as np

from polhode.backend.initialization.initialize import frame_rates
from polhode.lie import Array, log_so3
from polhode.records import Bools, Ints

AMBIGUOUS_TURN_RAD = np.deg2rad(90.0)
"""Median rotation between neighbouring frames above which both directions are tried."""
OPPOSITE_DIRECTION = ", the other way round"
"""Suffix of the name of a hypothesis with the longer rotations."""
MIN_INTERVALS = 3
FAST_HINT = "a possible cause: the target rotates by more than half a revolution between pairs"
"""Beyond the rotations that are tried in both directions, poses show the shorter one, which no body
follows."""


def rate_branches(time_s: Array, X_NG: Array, connected: Bools) -> dict[str, Array]:
    """Body rates (F, 3) [rad/s] by suffix of the hypothesis: one, or both directions of large rotations.

    time_s (F,), X_NG (F, 4, 4), connected (F,).
    """
    short = frame_rates(time_s, X_NG, connected)
    index: Ints = np.flatnonzero(connected[:-1] & connected[1:])
    if len(index) < MIN_INTERVALS:
        return {"": short}
    R, dt = X_NG[:, :3, :3], np.diff(time_s)[index]
    turn = log_so3(np.swapaxes(R[index], 1, 2) @ R[index + 1])
    if np.median(np.linalg.norm(turn, axis=1)) < AMBIGUOUS_TURN_RAD:
        return {"": short}
    centre = 0.5 * (time_s[index] + time_s[index + 1])
    both = {}
    for sense in (1.0, -1.0):
        rate = _along(turn, sense * _axis(turn)) / dt[:, None]
        both[float(np.median(np.linalg.norm(rate, axis=1)))] = np.stack(
            [np.interp(time_s, centre, rate[:, n]) for n in range(3)], axis=1
        )
    return {"": both[min(both)], OPPOSITE_DIRECTION: both[max(both)]}


def _axis(turn: Array) -> Array:
    """Direction (3,) that most of the rotations (n, 3) share up to sign."""
    unit = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(unit.T @ unit)
    return np.asarray(vectors[:, -1])


def _along(turn: Array, axis: Array) -> Array:
    """The same rotations (n, 3), below a revolution, in the direction of the axis."""
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    against = turn @ axis < 0.0
    return np.where(against[:, None], turn * (1.0 - 2.0 * np.pi / angle), turn)
