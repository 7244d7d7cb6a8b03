"""The first texture generator: stickers, lettering, seams, rivets (body.texture: drawn)."""

from polhode.simulation.bodies.textures.drawn.arrays import cells, radiator
from polhode.simulation.bodies.textures.drawn.blankets import blanket
from polhode.simulation.bodies.textures.drawn.hulls import nozzle_wall, reflector, ring_wall, tank_wall
from polhode.simulation.bodies.textures.drawn.panels import machined_plate, panel, plain

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
