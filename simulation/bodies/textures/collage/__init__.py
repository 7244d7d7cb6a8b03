"""The second texture generator: overlapping shapes of all sizes, strokes and glyphs (body.texture: collage).

sheets.py  flat sheets: panels, plates, solar cells, radiators, foil
walls.py   unrolled walls of tanks, rings, nozzles and reflectors
marks.py   single marks on them
"""

from polhode.simulation.bodies.textures.collage.sheets import (
    blanket,
    cells,
    machined_plate,
    panel,
    plain,
    radiator,
)
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
