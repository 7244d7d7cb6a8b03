"""Whether landmarks connect all parts of the sequence, or the dynamics alone do.

Where hardly a landmark is seen on both sides of an instant, what is common to both parts, the centre of mass,
the axes and the turn between them, rests on the motion that was predicted across. A wrong prediction, by a
wrong inertia or a fraction of a turn, fits each part, and no residual shows it.
"""

import numpy as np

from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import MotionEstimate, StereoTracks

MIN_LANDMARKS = 6
"""Three fix a pose, and some more agree with a wrong one by chance: four did, in one of the sequences of
benchmarks/robustness/data_faults.py. Undisturbed ones there share at least six throughout."""
MIN_FRAMES = 2
"""With observations, on either side: a single frame contributes little."""


def connection_check(tracks: StereoTracks, estimate: MotionEstimate) -> Check:
    """Whether landmarks connect all parts of the sequence."""
    check = Check(name="landmarks that connect the parts of the sequence", limit=MIN_LANDMARKS, at_least=True)
    good = estimate.inlier_weight > 0.1
    frame, landmark = tracks.frame[good], tracks.landmark[good]
    seen = np.unique(frame)
    if len(seen) < 2 * MIN_FRAMES:
        return check
    first = np.full(tracks.n_landmarks, tracks.n_frames)
    last = np.full(tracks.n_landmarks, -1)
    np.minimum.at(first, landmark, frame)
    np.maximum.at(last, landmark, frame)
    places = seen[MIN_FRAMES - 1 : len(seen) - MIN_FRAMES]
    shared = np.array([int(np.sum((first <= k) & (last > k))) for k in places])
    n, weak = int(np.argmin(shared)), int(np.sum(shared < MIN_LANDMARKS))
    start_s, end_s = (tracks.time_s[k] for k in (places[n], seen[MIN_FRAMES + n]))
    count = f"{shared[n] or 'no'} landmark{'' if shared[n] == 1 else 's'}"
    others = f" (the weakest of {weak} such places)" if weak > 1 else ""
    return check.judged(
        shared[n],
        f"the parts before {start_s:g} s and after {end_s:g} s share {count} and are connected by the "
        "dynamics alone: the turn between them, and what follows from it, no image confirms" + others,
    )
