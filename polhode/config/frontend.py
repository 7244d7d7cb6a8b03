"""Settings of the front end."""

from typing import Literal

from polhode.config.section import Section


class Frontend(Section):
    """Images to stereo measurements, tracks and depth."""

    features: Literal["rootsift"] = "rootsift"
    """Detector and descriptor."""
    depth: Literal["sgbm"] = "sgbm"
    """Dense stereo."""
