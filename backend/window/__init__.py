"""The sliding window: the causal estimate, frame by frame."""

from polhode.backend.window.causal_state import OnlineState
from polhode.backend.window.estimator import SlidingWindow
from polhode.backend.window.frame import CameraNoise, FrameMeasurements, camera_noise_of, frames_of
from polhode.backend.window.online import estimate_online, in_words_of, window_warnings

__all__ = [
    "CameraNoise",
    "FrameMeasurements",
    "OnlineState",
    "SlidingWindow",
    "camera_noise_of",
    "estimate_online",
    "frames_of",
    "in_words_of",
    "window_warnings",
]
