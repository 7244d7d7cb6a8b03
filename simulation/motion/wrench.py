"""Known forces and torques as they are written to ``wrench0/``: rows so dense that reading them is easy."""

import numpy as np

from polhode.config import scene as config
from polhode.lie import Array
from polhode.records import Ints
from polhode.simulation.motion.forces import span_s
from polhode.simulation.motion.target import timestamps

LONGEST_STEP_S = 0.05
STEPS_PER_PERIOD = 200


def known_wrench(scene: config.Scene) -> tuple[Ints, Array, Array] | None:
    """Times (n,) [ns], forces (n, 3) in N [N], torques (n, 3) in P [N m]; None where nothing is known.

    From the first frame to the end of the truth, at 20 Hz or more; 200 rows a period of a sine, and two rows
    1 ns apart where the wrench jumps. So it matters little whether a reader interpolates or holds the rows.
    """
    pushes = scene.motion.pushes
    if not pushes or not scene.motion.pushes_known:
        return None
    stamps = timestamps(scene)
    rows_ns = _rows_ns(pushes, int(stamps[-1] - stamps[0]))
    force_N, torque_P = np.zeros((len(rows_ns), 3)), np.zeros((len(rows_ns), 3))
    for push in pushes:
        start_ns, end_ns = _span_ns(push)
        shape = ((start_ns <= rows_ns) & (rows_ns < end_ns)).astype(np.float64)
        if push.period_s is not None:
            shape *= np.sin(2.0 * np.pi * (rows_ns - start_ns) * 1e-9 / push.period_s)
        force_N += shape[:, None] * push.force_N
        torque_P += shape[:, None] * push.torque_P
    return stamps[0] + rows_ns, force_N, torque_P


def _rows_ns(pushes: tuple[config.Push, ...], last_ns: int) -> Ints:
    """Times after the first frame, increasing, from zero to ``last_ns``."""
    rows = [_evenly_ns(0, last_ns, LONGEST_STEP_S)]
    for push in pushes:
        start_ns, end_ns = _span_ns(push)
        rows.append(np.array([start_ns - 1, start_ns, end_ns - 1, end_ns]))
        if push.period_s is not None and start_ns < last_ns:
            rows.append(_evenly_ns(start_ns, min(end_ns, last_ns), push.period_s / STEPS_PER_PERIOD))
    rows_ns = np.unique(np.concatenate(rows))
    return rows_ns[(rows_ns >= 0) & (rows_ns <= last_ns)]


def _evenly_ns(start_ns: int, end_ns: int, longest_step_s: float) -> Ints:
    steps = int(np.ceil((end_ns - start_ns) * 1e-9 / longest_step_s))
    return np.linspace(start_ns, end_ns, steps + 1).round().astype(np.int64)


def _span_ns(push: config.Push) -> tuple[int, int]:
    start_s, end_s = span_s(push)
    return round(start_s * 1e9), round(end_s * 1e9)
