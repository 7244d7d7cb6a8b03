"""The texture generators by their names in a scene."""

from simulation.bodies import drawn
from simulation.bodies.studio import Artist


def artist_of(texture: str) -> Artist:
    """The generator called ``drawn`` or ``collage``."""
    return drawn
