"""The sliding window: the causal estimate, frame by frame."""

from backend.window.estimator import SlidingWindow
from backend.window.frame import CameraNoise, FrameMeasurements, camera_noise_of, frames_of
from backend.window.online import estimate_online, in_words_of, window_warnings
from backend.window.state import OnlineState

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
