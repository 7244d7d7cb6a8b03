"""A small tumble, and a window that has seen some of it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from polhode.backend.window.causal_state import OnlineState
from polhode.backend.window.estimator import SlidingWindow
from polhode.backend.window.frame import camera_noise_of, frames_of
from polhode.backend.window.problem import WindowProblem
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

TUMBLE = SyntheticScene(
    frames=40,
    landmarks=500,
    detection=0.4,
    w_G=(0.4, 0.5, 0.45),
    J_G=np.diag([1.5, 1.2, 0.9]),
    sigma_uv_px=0.3,
    sigma_d_px=0.3,
)
Fed = tuple[SlidingWindow, list[OnlineState]]
Feed = Callable[..., Fed]


@pytest.fixture(scope="session")
def tumble() -> SyntheticSequence:
    return generate(TUMBLE, 0)


@pytest.fixture(scope="session")
def feed() -> Feed:
    """Feed the first frames of a sequence to a window with given settings."""

    def run(
        sequence: SyntheticSequence, n_frames: int = 1000, inertia: str = "second_moments", **window: Any
    ) -> Fed:
        config = Backend.model_validate({"process_noise": "given", "inertia": inertia, "window": window})
        estimator = SlidingWindow(sequence.tracks.rig, config, camera_noise_of(sequence.tracks))
        frames = [m for k, m in enumerate(frames_of(sequence.tracks)) if k < n_frames]
        return estimator, [estimator.add(m) for m in frames]

    return run


def problem_of(window: SlidingWindow) -> tuple[WindowProblem, Array]:
    """The program of the whole history as it stands, and where the window is."""
    state, history = window.state, window.state.history
    assert history is not None
    x = history.vector(state.active.constants)
    vision = history.vision(state.active, state.condensed()).quadratic
    return state.problem(vision, history.R_ref, history.steps), x
