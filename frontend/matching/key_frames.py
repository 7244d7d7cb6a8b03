"""Which frames of a long stream stay to be matched with: those that others do not tell the same of.

Two frames tell the same if they show the target from the same side at nearly the same time. Time counts as a
share of the time so far, so that the frames of an earlier hour thin out as a later one comes: what is kept is
spread evenly over the views and over the sequence.
"""

import numpy as np

from polhode.frontend.matching.pairs import MAX_NEIGHBOUR_STEPS
from polhode.geometry.lie import Array, Bools, Ints

WHOLE_TIME = 1.0
"""Distance of the first and the last moment, in the unit of the distance between viewing directions [rad]."""
LET_GO_AT_A_TIME = 2
"""So many frames leave after each new one, until the number is reached: no frame waits for many to leave."""


def frames_to_let_go(views_G: Array, time_s: Array, number: int, most: int = LET_GO_AT_A_TIME) -> Ints:
    """Indices, ascending, of at most ``most`` of the kept frames without which ``number`` remain.

    views_G (n, 3): viewing directions in G of the kept frames in the order of time, NaN where they are
    unknown; time_s (n,) since the first frame. The first frame and the latest ones, which a new frame is
    always matched with, stay.
    """
    n = len(time_s)
    gone: Bools = np.zeros(n, dtype=np.bool_)
    if n <= number:
        return np.zeros(0, dtype=np.int64)
    known = np.isfinite(views_G[:, 0])
    place = np.hstack([
        np.where(known[:, None], views_G, 0.0),
        WHOLE_TIME * time_s[:, None] / max(float(time_s[-1]), 1e-9),
    ])  # fmt: skip
    squares = np.sum(place**2, axis=1)
    distance = squares[:, None] + squares[None, :] - 2.0 * place @ place.T
    np.fill_diagonal(distance, np.inf)
    stays = np.zeros(n, dtype=np.bool_)
    stays[0] = stays[-MAX_NEIGHBOUR_STEPS:] = True
    # the latest ones will leave: a frame must not leave because they tell the same of it
    distance[:, -MAX_NEIGHBOUR_STEPS:] = np.inf
    for _ in range(min(most, n - number)):
        nearest = np.partition(distance, 1, axis=1)[:, :2]
        # a frame of unknown view is no key frame; of the two nearest ones, that with nearer others
        worth = np.where(known, nearest[:, 0], -1.0) + 1e-6 * np.where(known, nearest[:, 1], 0.0)
        worth[stays | gone] = np.inf
        if not np.isfinite(worth).any():
            break
        leaves = int(np.argmin(worth))
        gone[leaves] = True
        distance[leaves], distance[:, leaves] = np.inf, np.inf
    return np.flatnonzero(gone)
