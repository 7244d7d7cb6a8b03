"""Key frames are spread over what is seen, and serve when it comes back."""

from dataclasses import replace

import numpy as np

from polhode.backend.window.estimator_state import least_valuable
from polhode.geometry.lie import log_so3
from polhode.simulation.monte_carlo import generate
from tests.backend.window.conftest import TUMBLE, Feed


def test_key_frames_spread_over_the_attitudes_and_are_seen_again_after_a_revolution(feed: Feed) -> None:
    # a slow start: most of the first frames look alike; then all sides
    sequence = generate(replace(TUMBLE, frames=60, dt_s=0.3, w_G=(0.05, 0.7, 0.05)), 1)
    window, _ = feed(sequence, frames=5, key_frames=8, history=12)
    active = window.state.active
    keys = active.keys
    turns = np.array([[np.linalg.norm(log_so3(a.R_NG.T @ b.R_NG)) for b in keys] for a in keys])
    # 60 frames of 12 degrees turn twice: eight keys could all lie within 96 degrees
    assert turns.max() > np.deg2rad(150.0)
    assert np.min(turns + 10.0 * np.eye(len(keys))) > np.deg2rad(3.0)
    newest = set(active.recent[-1].slot.tolist())
    assert any(len(newest & set(key.slot.tolist())) > 5 for key in keys)


def test_a_frame_that_nobody_needs_leaves_first(feed: Feed) -> None:
    sequence = generate(replace(TUMBLE, frames=20, dropped=(8,)), 1)
    window, _ = feed(sequence, frames=5, key_frames=16, history=40)
    keys = window.state.active.keys
    empty = [n for n, key in enumerate(keys) if len(key.slot) == 0]
    assert empty == [8] and least_valuable(window.state) == 8
