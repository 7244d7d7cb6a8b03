"""Links between neighbouring frames whose turn goes on in the links around them: these cannot be look-alikes.

Sides of a body that look alike (a truss by half-turns, a drum by any turn) give links that are wrong by that
symmetry, many of them, and they close triangles among themselves. But no body jumps to another side and back:
of the links between near frames those are right that agree on one rate of turn.
"""

import numpy as np

from polhode.lie import Array, exp_so3, log_so3
from polhode.records import Bools, RelativePoses

NEAR = 3
"""Frames between the ends of a link that tells the rate: beyond it nutation bends the turn."""
AROUND = 2.5
"""Links whose middles are so many frames apart tell the same rate."""
SAME_TURN_RAD = np.deg2rad(20.0)
"""Links whose turns differ by less go on in each other; symmetries of bodies are wider."""
LEAST_SHARE = 0.6
"""Of the inliers around a link, in links that agree with it."""
FEWEST = 2
"""Links that agree with it."""


def smooth_links(relative: RelativePoses, usable: Bools, time_s: Array, R_NR: Array) -> Bools:
    """Which links (E,) go on in others; time_s (F,) [s], R_NR (F, 3, 3) attitudes of the camera."""
    near = np.flatnonzero(usable & (np.abs(relative.j - relative.i) <= NEAR))
    smooth = np.zeros(len(usable), dtype=np.bool_)
    if len(near) <= FEWEST:
        return smooth
    i, j, inliers = relative.i[near], relative.j[near], relative.inliers[near].astype(np.float64)
    # the turn of the target in N from frame j back to frame i
    turn = R_NR[i] @ relative.X_RiRj[near, :3, :3] @ np.swapaxes(R_NR[j], 1, 2)
    dt_s = time_s[j] - time_s[i]
    rate = log_so3(turn) / dt_s[:, None]
    middle = 0.5 * (i + j)
    for n, link in enumerate(near):
        others = np.flatnonzero(np.abs(middle - middle[n]) <= AROUND)
        others = others[others != n]
        expected = exp_so3(rate[n] * dt_s[others, None])
        off = np.linalg.norm(log_so3(np.swapaxes(expected, 1, 2) @ turn[others]), axis=1)
        agree = off < SAME_TURN_RAD
        share = np.sum(inliers[others][agree]) / max(np.sum(inliers[others]), 1.0)
        smooth[link] = agree.sum() >= FEWEST and share >= LEAST_SHARE
    return smooth
