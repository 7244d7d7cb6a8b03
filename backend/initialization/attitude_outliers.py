"""Frames with a wrong attitude due to a symmetry of the body: the rotation jumps there and jumps back.

A body whose sides look alike (by a half-turn about the axis of a panel, for example) may give frames with few
features a pose that is wrong by that symmetry. No rigid body jumps and jumps back; such frames are better
interpolated, and located again later.
"""

from itertools import pairwise

import numpy as np

from polhode.lie import Array, exp_so3, log_so3
from polhode.records import Bools, Ints

JUMP_RAD = np.deg2rad(60.0)
"""A larger deviation from the local rate is a jump; nutation causes smaller ones."""
FAR_RAD = np.deg2rad(75.0)
"""With larger rotations between frames any tumbling motion seems to jump."""
NEIGHBOURS = 9
"""Number of intervals whose median is the local rate."""
MAX_SHARE = 0.25
"""Share of the connected frames; a longer stretch is not the outlier."""


def jumping_frames(time_s: Array, R_NG: Array, connected: Bools) -> Bools:
    """(F,) frames without which the rotation is smooth; time_s (F,), R_NG (F, 3, 3), connected (F,)."""
    index: Ints = np.flatnonzero(connected)
    odd = np.zeros(len(time_s), dtype=np.bool_)
    if len(index) < NEIGHBOURS:
        return odd
    local = _local_rates(time_s[index], R_NG[index])
    if np.median(np.linalg.norm(local[0], axis=1)) * np.median(np.diff(time_s[index])) > FAR_RAD:
        return odd
    strays = [_prediction_error_rad(time_s, R_NG, a, b, local) for a, b in pairwise(index)]
    stretches: list[Ints] = list(np.split(index, np.flatnonzero(np.array(strays) > JUMP_RAD) + 1))
    limit = MAX_SHARE * len(index)
    while len(stretches) > 1:
        n = _odd_one(time_s, R_NG, stretches, local)
        if n is None or len(stretches[n]) > limit:
            break
        odd[stretches[n]] = True
        inner = [np.concatenate([stretches[n - 1], stretches[n + 1]])] if 0 < n < len(stretches) - 1 else []
        stretches = (
            [*stretches[: max(n - 1, 0)], *inner, *stretches[n + 2 :]]
            if inner
            else (stretches[1:] if n == 0 else stretches[:-1])
        )
    return odd


def _odd_one(time_s: Array, R_NG: Array, stretches: list[Ints], local: tuple[Array, Array]) -> int | None:
    """The shortest stretch without which its neighbours fit together; else the shorter one at the ends."""
    joining = [
        n
        for n in range(1, len(stretches) - 1)
        if _prediction_error_rad(time_s, R_NG, stretches[n - 1][-1], stretches[n + 1][0], local) < JUMP_RAD
    ]
    if joining:
        return min(joining, key=lambda n: len(stretches[n]))
    return min((0, len(stretches) - 1), key=lambda n: len(stretches[n]))


def _local_rates(time_s: Array, R_NG: Array) -> tuple[Array, Array]:
    """Median body rate (n - 1, 3) [rad/s] around each interval, and the intervals' middles (n - 1,) [s]."""
    turn = log_so3(np.swapaxes(R_NG[:-1], 1, 2) @ R_NG[1:])
    rate = turn / np.diff(time_s)[:, None]
    half = NEIGHBOURS // 2
    windows = [rate[max(0, k - half) : k + half + 1] for k in range(len(rate))]
    return np.stack([np.median(window, axis=0) for window in windows]), 0.5 * (time_s[:-1] + time_s[1:])


def _prediction_error_rad(time_s: Array, R_NG: Array, a: int, b: int, local: tuple[Array, Array]) -> float:
    """Angle [rad] between the attitude of frame b and its prediction from frame a by the local rate."""
    rate, centre = local
    middle = 0.5 * (time_s[a] + time_s[b])
    here = np.array([np.interp(middle, centre, rate[:, axis]) for axis in range(3)])
    expected = R_NG[a] @ exp_so3(here * (time_s[b] - time_s[a]))
    return float(np.linalg.norm(log_so3(expected.T @ R_NG[b])))
