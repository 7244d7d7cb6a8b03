"""Frames leave the window: key frames are chosen, what the others saw goes to the arrival cost."""

import numpy as np

from backend.window.belief import Belief
from backend.window.vision import N_POSE, information_of, poses_of, residuals

GATE = 4.5
"""Largest norm of a whitened residual that may leave with its frame; of Gaussian ones 1 in 5700 is larger."""


def release(belief: Belief, n_recent: int, n_keys: int) -> None:
    """Keep the latest states and the most valuable key poses, in these numbers."""
    active = belief.active
    while len(active.recent) > n_recent:
        if belief.history is None:
            active.turn_oldest_to_key(belief.shape.form, belief.R_inertia)
        else:
            active.shift()
        while len(active.keys) > n_keys:
            drop_key(belief, least_valuable(belief))


def least_valuable(belief: Belief) -> int:
    """The key frame whose landmarks are seen by the most other frames.

    Each of its observations counts as the share that it is of those of its landmark: a frame that shows a
    side of the target that no other shows is worth its number of landmarks.
    """
    worth = [np.sum(1.0 / belief.landmarks.views[frame.slot]) for frame in belief.active.keys]
    return int(np.argmin(worth))


def drop_key(belief: Belief, k: int) -> None:
    """What key frame k saw becomes information on the poses; its pose is eliminated."""
    active, history = belief.active, belief.history
    _leave_out_contradictions(belief, k)
    sight, poses = belief.sight(), poses_of(active.frames)
    p_G = belief.landmarks.p_G[sight.slot]
    H, g = information_of(k, sight, poses, belief.rig_vector, p_G, belief.robust_scale, belief.gain)
    for frame in active.frames:
        frame.hold()
    if history is None:
        active.touch(active.pose_entries, H, g)
        active.forget(np.arange(N_POSE * k, N_POSE * (k + 1)))
    else:
        history.absorb(active.frames, H, g)
    frame = active.keys.pop(k)
    belief.landmarks.leave(frame.slot)
    frame.keep(np.zeros(len(frame.slot), bool))


def _leave_out_contradictions(belief: Belief, k: int) -> None:
    """Observations of key frame k beyond the gate leave, with nothing said."""
    frame, sight = belief.active.keys[k], belief.sight()
    p_G = belief.landmarks.p_G[sight.slot]
    r = residuals(sight, poses_of(belief.active.frames), belief.rig_vector, p_G)
    wrong = (sight.frame == k) & (np.sum(r**2, axis=1) > GATE**2)
    if wrong.any():
        slots = sight.slot[sight.landmark[wrong]]
        belief.landmarks.leave(slots)
        frame.keep(~np.isin(frame.slot, slots))
