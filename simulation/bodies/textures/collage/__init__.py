"""The second texture generator: overlapping shapes of all sizes, strokes and glyphs (body.texture: collage).

It shares no drawing code with ``simulation.bodies.drawn``: what is trained on one can be tested on the other.
"""

from polhode.simulation.bodies.textures.collage.sheets import blanket, machined_plate, panel, plain
from polhode.simulation.bodies.textures.collage.tiles import cells, radiator
from polhode.simulation.bodies.textures.collage.walls import nozzle_wall, reflector, ring_wall, tank_wall

__all__ = [
    "blanket",
    "cells",
    "machined_plate",
    "nozzle_wall",
    "panel",
    "plain",
    "radiator",
    "reflector",
    "ring_wall",
    "tank_wall",
]
