"""Measurements to motion, mass properties and covariance."""

from polhode.backend.estimate import estimate_motion
from polhode.backend.initialization.initialize import initialize_motion, undisputed_links
from polhode.backend.window.online import estimate_online, in_words_of, window_warnings

__all__ = [
    "estimate_motion",
    "estimate_online",
    "in_words_of",
    "initialize_motion",
    "undisputed_links",
    "window_warnings",
]
