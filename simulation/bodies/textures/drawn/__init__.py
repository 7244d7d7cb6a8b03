"""The first texture generator: stickers, lettering, seams, rivets (body.texture: drawn).

sheets.py  flat sheets: panels, plates, solar cells, radiators, foil
walls.py   unrolled walls of tanks, rings, nozzles and reflectors
marks.py   single marks on them
"""

from polhode.simulation.bodies.textures.drawn.sheets import (
    blanket,
    cells,
    machined_plate,
    panel,
    plain,
    radiator,
)
from polhode.simulation.bodies.textures.drawn.walls import nozzle_wall, reflector, ring_wall, tank_wall

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
