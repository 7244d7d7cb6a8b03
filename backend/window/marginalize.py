"""Frames leave the window: key frames are selected, the observations of others are marginalized."""

import numpy as np

from polhode.backend.problem.iterate import N_POSE
from polhode.backend.window.estimator_state import EstimatorState
from polhode.backend.window.vision import STEREO_GATE, FramePoses, information_of, residuals
from polhode.geometry.lie import Array


def shrink_window(state: EstimatorState, n_recent: int, n_keys: int) -> None:
    """Keep the latest states and the most valuable key poses, at most these numbers."""
    active = state.active
    while len(active.recent) > n_recent:
        dropped = least_valuable(state) if len(active.keys) >= n_keys else None
        if state.history is None:
            _marginalize(state, dropped)
        else:
            if dropped is not None:
                state.history.absorb(active.frames, *_condense(state, dropped))
            active.oldest_becomes_key()
        if dropped is not None:
            frame = active.keys.pop(dropped)
            state.landmarks.leave(frame.slot)
            frame.keep(np.zeros(len(frame.slot), bool))


def least_valuable(state: EstimatorState) -> int:
    """Of the key frames and the oldest recent frame, the one whose landmarks are seen most in other frames.

    Each observation counts with its share of the observations of its landmark: a frame that shows a side of
    the target that no other frame shows has its number of landmarks as value.
    """
    candidates = [*state.active.keys, state.active.recent[0]]
    worth = [np.sum(1.0 / state.landmarks.views[frame.slot]) for frame in candidates]
    return int(np.argmin(worth))


def _marginalize(state: EstimatorState, dropped: int | None) -> None:
    """Marginalize velocities and step of the oldest state into the arrival cost; its pose becomes a key.

    ``dropped``: index of a key, or of the new one, that is marginalized completely.
    """
    active = state.active
    parts = [active.oldest_step(state.prior.form, state.R_inertia), *active.camera_parts(1)]
    gone = [active.oldest_velocities()]
    if dropped is not None:
        parts.append((active.seen_entries, *_condense(state, dropped)))
        gone.append(np.arange(N_POSE * dropped, N_POSE * (dropped + 1)))
    active.absorb(parts, np.concatenate(gone))
    active.oldest_becomes_key()
    active.steps = active.steps.part(slice(1, None))
    for frame in (active.keys[-1], active.recent[0]):
        frame.fix_linearization()


def _condense(state: EstimatorState, k: int) -> tuple[Array, Array]:
    """Information on all poses, and its gradient, from the observations of frame k alone.

    Landmarks whose residual in frame k exceeds the gate are left out.
    """
    frames, p_G = state.active.frames, state.landmarks.p_G
    poses = FramePoses(frames)
    observations = state.observations().common_with(k)
    r = residuals(observations, poses, state.model.rig, p_G[observations.slot])
    wrong = (observations.frame == k) & (np.sum(r**2, axis=1) > STEREO_GATE**2)
    bad = np.zeros(len(observations.slot), bool)
    bad[observations.landmark[wrong]] = True
    observations = observations.select(~bad) if bad.any() else observations
    H, g = information_of(k, observations, poses, state.model, p_G[observations.slot])
    for frame in frames:
        frame.fix_linearization()
    return H, g
