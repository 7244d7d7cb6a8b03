"""The first texture generator: stickers, lettering, seams, rivets (body.texture: drawn)."""

from simulation.bodies.drawn.arrays import cells, radiator
from simulation.bodies.drawn.blankets import blanket
from simulation.bodies.drawn.hulls import nozzle_wall, reflector, ring_wall, tank_wall
from simulation.bodies.drawn.panels import machined_plate, panel, plain

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
