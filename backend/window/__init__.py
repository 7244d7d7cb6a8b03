"""The sliding window: the causal estimate, frame by frame."""

from backend.window.estimator import SlidingWindow
from backend.window.frame import FrameMeasurements, frames_of
from backend.window.online import estimate_online, in_words_of
from backend.window.state import OnlineState

__all__ = [
    "FrameMeasurements",
    "OnlineState",
    "SlidingWindow",
    "estimate_online",
    "frames_of",
    "in_words_of",
]
