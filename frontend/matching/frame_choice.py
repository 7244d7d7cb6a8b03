"""Which frames of a stream a new one is matched with, and which of them stay to be matched with.

A new frame is matched with the latest ones and with those of the same side, by the predicted attitude: after
a revolution, a side is recognised in the frames that showed it first. Of frames next to each other in time
that show nearly the same, only one is taken.

Of a long stream key frames stay. Two frames show the same if they show the target from the same side at
nearly the same time. Time counts as a share of the time so far, so that the frames of an earlier hour thin
out as a later one comes. What is kept is spread evenly over the views, and over the sequence as far as the
views allow: there may be gaps of half of it.
"""

import numpy as np

from polhode.frontend.matching.pairs import MAX_NEIGHBOUR_STEPS, MAX_VIEW_ANGLE_DEG
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose

FIRST_FRAMES = 10
"""So many frames are matched with all before: the motion is not known yet."""
MOST_IN_VIEW = 24
"""Frames of the same side that a new one is matched with, besides its neighbours in time."""
APART_FRAMES, APART_DEG = 3, 5.0
"""Of frames that are closer in time and in viewing direction, only one is taken."""
LET_GO_AT_A_TIME = 2
"""So many frames leave after each new one, until the number is reached: no frame waits for many to leave."""


def viewing_direction_G(X_NR: Array, X_NG: Array) -> Array:
    """Unit vector (3,) in G from the target's origin to the camera."""
    p_GR = (inverse_pose(X_NG) @ X_NR)[:3, 3]
    return np.asarray(p_GR / max(float(np.linalg.norm(p_GR)), 1e-12))


def earlier_frames(views_G: Array, predicted_G: Array | None) -> Ints:
    """Numbers of the earlier frames, ascending, that a new frame is matched with.

    views_G (k, 3): viewing directions of the k earlier frames in the present frame G, NaN where they are
    unknown; predicted_G (3,): that of the new one, None: it is unknown.
    """
    k = len(views_G)
    if k <= FIRST_FRAMES:
        return np.arange(k, dtype=np.int64)
    chosen = list(range(k - MAX_NEIGHBOUR_STEPS, k))
    if predicted_G is not None:
        cosine = np.where(np.isfinite(views_G[:, 0]), views_G @ predicted_G, -np.inf)
        cosine[k - MAX_NEIGHBOUR_STEPS :] = -np.inf
        for j in np.argsort(-cosine, kind="stable").tolist():
            if cosine[j] <= np.cos(np.deg2rad(MAX_VIEW_ANGLE_DEG)):
                break
            if len(chosen) == MAX_NEIGHBOUR_STEPS + MOST_IN_VIEW:
                break
            near = [other for other in chosen if abs(j - other) < APART_FRAMES]
            if not (views_G[near] @ views_G[j] > np.cos(np.deg2rad(APART_DEG))).any():
                chosen.append(j)
    return np.array(sorted(chosen), dtype=np.int64)


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
    # the first and the last moment are as far apart as viewing directions by a radian
    place = np.hstack([
        np.where(known[:, None], views_G, 0.0),
        time_s[:, None] / max(float(time_s[-1]), 1e-9),
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
