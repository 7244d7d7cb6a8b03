"""The texture generators by their names in a scene."""

from typing import Literal

from simulation.bodies import collage, drawn
from simulation.bodies.studio import Artist


def artist_of(texture: Literal["drawn", "collage"]) -> Artist:
    """The generator of that name."""
    return drawn if texture == "drawn" else collage
