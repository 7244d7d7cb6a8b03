"""With which earlier frames a new one is matched as it arrives: the latest, and those of the same side.

Which frames saw the same side follows from the predicted attitude: after a revolution, a side is recognised
in the frames that showed it first. Of frames next to each other in time that show nearly the same, only one
is taken.
"""

import numpy as np

from polhode.frontend.matching.pairs import MAX_NEIGHBOUR_STEPS, MAX_VIEW_ANGLE_DEG
from polhode.geometry.lie import Array, Ints, inverse_pose

FIRST_FRAMES = 10
"""So many frames are matched with all before: the motion is not known yet."""
MOST_IN_VIEW = 24
"""Frames of the same side that a new one is matched with, besides its neighbours in time."""
APART_FRAMES, APART_DEG = 3, 5.0
"""Of frames that are closer in time and in viewing direction, only one is taken."""


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
