"""Whether landmarks connect all parts of the sequence, or the dynamics alone do.

Where hardly a landmark is seen on both sides of an instant, what is common to both parts, the centre of mass,
the axes and the turn between them, rests on the motion that was predicted across. A wrong prediction, by a
wrong inertia or a fraction of a turn, fits each part, and no residual shows it.
"""

import numpy as np

from polhode.records import MotionEstimate, StereoTracks

MIN_LANDMARKS = 6
"""Three fix a pose, and some more agree with a wrong one by chance: four did, in one of the sequences of
benchmarks/robustness/data_faults.py. Undisturbed ones there share at least six throughout."""
MIN_FRAMES = 2
"""With observations, on either side: a single frame contributes little."""


def weak_connections(tracks: StereoTracks, estimate: MotionEstimate) -> list[str]:
    """What rests on the dynamics alone, in words; mostly nothing."""
    good = estimate.inlier_weight > 0.1
    frame, landmark = tracks.frame[good], tracks.landmark[good]
    seen = np.unique(frame)
    if len(seen) < 2 * MIN_FRAMES:
        return []
    first = np.full(tracks.n_landmarks, tracks.n_frames)
    last = np.full(tracks.n_landmarks, -1)
    np.minimum.at(first, landmark, frame)
    np.maximum.at(last, landmark, frame)
    places = seen[MIN_FRAMES - 1 : len(seen) - MIN_FRAMES]
    shared = np.array([int(np.sum((first <= k) & (last > k))) for k in places])
    weak = np.flatnonzero(shared < MIN_LANDMARKS)
    if len(weak) == 0:
        return []
    n = int(weak[np.argmin(shared[weak])])
    start_s, end_s = (tracks.time_s[k] for k in (places[n], seen[MIN_FRAMES + n]))
    count = f"{shared[n] or 'no'} landmark{'' if shared[n] == 1 else 's'}"
    others = f" (the weakest of {len(weak)} such places)" if len(weak) > 1 else ""
    return [
        f"the parts before {start_s:g} s and after {end_s:g} s share {count} and are connected by the "
        "dynamics alone: the turn between them, and what follows from it, no image confirms" + others
    ]
