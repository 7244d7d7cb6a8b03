"""Frames leave the window: key frames are chosen, what the others saw goes to the arrival cost."""

import numpy as np

from polhode.backend.problem.iterate import N_POSE
from polhode.backend.window.estimator_state import Belief
from polhode.backend.window.vision import GATE, Poses, Sight, information_of, poses_of, residuals
from polhode.lie import Array


def release(belief: Belief, n_recent: int, n_keys: int) -> None:
    """Keep the latest states and the most valuable key poses, in these numbers."""
    active = belief.active
    while len(active.recent) > n_recent:
        dropped = least_valuable(belief) if len(active.keys) >= n_keys else None
        if belief.history is None:
            _marginalize(belief, dropped)
        else:
            if dropped is not None:
                belief.history.absorb(active.frames, *_condense(belief, dropped))
            active.shift()
        if dropped is not None:
            frame = active.keys.pop(dropped)
            belief.landmarks.leave(frame.slot)
            frame.keep(np.zeros(len(frame.slot), bool))


def least_valuable(belief: Belief) -> int:
    """Among the keys and the oldest recent frame: whose landmarks are seen by the most other frames.

    Each observation counts as the share that it is of those of its landmark: a frame that shows a side of
    the target that no other shows is worth its number of landmarks.
    """
    candidates = [*belief.active.keys, belief.active.recent[0]]
    worth = [np.sum(1.0 / belief.landmarks.views[frame.slot]) for frame in candidates]
    return int(np.argmin(worth))


def _marginalize(belief: Belief, dropped: int | None) -> None:
    """The oldest state's velocities and its step go to the arrival cost; its pose becomes a key.

    ``dropped``: a key, or the one it becomes, of which nothing stays.
    """
    active = belief.active
    parts = [active.oldest_step(belief.shape.form, belief.R_inertia), *active.camera_parts(1)]
    gone = [active.oldest_velocities()]
    if dropped is not None:
        parts.append((active.seen_entries, *_condense(belief, dropped)))
        gone.append(np.arange(N_POSE * dropped, N_POSE * (dropped + 1)))
    active.absorb(parts, np.concatenate(gone))
    active.shift()
    active.links = active.links.part(slice(1, None))
    for frame in (active.keys[-1], active.recent[0]):
        frame.fix_linearization()


def _condense(belief: Belief, k: int) -> tuple[Array, Array]:
    """Information on all poses, and its gradient, by what frame k alone sees."""
    frames = belief.active.frames
    poses = poses_of(frames)
    sight = _without_contradictions(belief, k, belief.sight().common_with(k), poses)
    p_G = belief.landmarks.p_G[sight.slot]
    H, g = information_of(k, sight, poses, belief.rig_vector, p_G, belief.robust_scale, belief.gain)
    for frame in frames:
        frame.fix_linearization()
    return H, g


def _without_contradictions(belief: Belief, k: int, sight: Sight, poses: Poses) -> Sight:
    """Observations of frame k beyond the gate leave, with nothing said."""
    r = residuals(sight, poses, belief.rig_vector, belief.landmarks.p_G[sight.slot])
    wrong = (sight.frame == k) & (np.sum(r**2, axis=1) > GATE**2)
    bad = np.zeros(len(sight.slot), bool)
    bad[sight.landmark[wrong]] = True
    return sight.of(~bad) if bad.any() else sight
