"""Description of a simulated scene; every value with its unit."""

from polhode.config.section import Section


class Scene(Section):
    """What ``polhode simulate`` renders."""

    frames: int = 115
    """Number of stereo pairs."""
