"""Whether the time stamps agree with the motion: a clock that jumps is taken for a torque, and back.

Between two frames the target turns by an angle that the poses show, whatever the clock. At the rates before
and after it, the turn takes a time; where that is not the time between the stamps, the clock has jumped, or
frames bear stamps of others.
"""

from itertools import pairwise

import numpy as np

from polhode.lie import Array, log_so3
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import Bools

MAX_ERROR = 0.08
"""Of the time, over the longer of the stated and the usual interval: good sequences show 0.004 at most."""
MAX_CHANGE = 0.2
"""Of the rate over a step, for its mean to be that of the step."""
MAX_TURN_DEG = 120.0
"""Over a longer turn, the rates before and after it say little."""
MAX_ACROSS = 0.15
"""Share of a turn that may be about another axis than the rates, for the turn to be the same rotation."""
MIN_TURN_DEG = 3.0


def clock_check(time_s: Array, R_NG: Array, seen: Bools) -> Check:
    """Whether the stamps agree with the rotation.

    time_s (F,) [s], R_NG (F, 3, 3), seen (F,): with observations. Only steps between frames that are seen,
    with a seen frame before and one after, are judged.
    """
    check = Check(name="time of a turn, against the stamps", limit=100.0 * MAX_ERROR, unit="%")
    stated, needed = np.diff(time_s), needed_s(time_s, R_NG, seen)
    if not np.isfinite(needed).any():
        return check
    error_s = np.abs(needed - stated)
    relative = error_s / np.maximum(stated, np.median(stated))
    worst = int(np.argmax(np.where(relative > MAX_ERROR, error_s, 0.0)))
    return check.judged(
        100.0 * float(np.nanmax(relative)),
        f"the time stamps contradict the rotation, most after {time_s[worst]:g} s: within the "
        f"{stated[worst]:.2f} s that they state the target turned as it does in {needed[worst]:.2f} s "
        "before and after; the clock may have jumped, and rates and disturbances there are not those of the "
        "target",
    )


def needed_s(time_s: Array, R_NG: Array, seen: Bools) -> Array:
    """(F - 1,) time of each step at the mean of the rates before and after it [s]; NaN: not judged."""
    turns = log_so3(R_NG[1:] @ np.swapaxes(R_NG[:-1], 1, 2))
    dt_s = np.diff(time_s)
    rates = turns / dt_s[:, None]
    whole = np.array([bool(a and b) for a, b in pairwise(seen)])
    out = np.full(len(dt_s), np.nan)
    for k in range(1, len(dt_s) - 1):
        if not whole[k - 1 : k + 2].all():
            continue
        rate, turn = 0.5 * (rates[k - 1] + rates[k + 1]), turns[k]
        speed, angle = float(np.linalg.norm(rate)), float(np.linalg.norm(turn))
        longest = max(angle, speed * dt_s[k], float(np.linalg.norm(turns[[k - 1, k + 1]], axis=1).max()))
        if longest > np.deg2rad(MAX_TURN_DEG) or angle < np.deg2rad(MIN_TURN_DEG):
            continue
        along = float(turn @ rate) / speed**2
        if np.linalg.norm(turn - along * rate) < MAX_ACROSS * angle and _alike(rates[k - 1], rates[k + 1]):
            out[k] = along
    return out


def _alike(before: Array, after: Array) -> bool:
    """Whether two rates are nearly the same: else a step beside this one is the odd one."""
    return bool(
        np.linalg.norm(before - after) < MAX_CHANGE * max(np.linalg.norm(before), np.linalg.norm(after))
    )
