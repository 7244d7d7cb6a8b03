"""The texture generators by their names in a scene."""

from typing import Literal

from polhode.simulation.bodies.textures import collage, drawn
from polhode.simulation.bodies.textures.studio import Artist


def artist_of(texture: Literal["drawn", "collage"]) -> Artist:
    """The generator of that name."""
    return drawn if texture == "drawn" else collage
