"""One material for a whole body, as ``body.material`` asks."""

from dataclasses import replace
from typing import Literal

from polhode.simulation.bodies.parts.part import Part, gathered
from polhode.simulation.bodies.textures.dressing import dressed
from polhode.simulation.bodies.textures.studio import Studio
from polhode.simulation.surface.materials import (
    BRUSHED_METAL,
    FOIL_SILVER,
    GLASS,
    PAINT_WHITE,
    REGOLITH,
    SOLAR_CELL,
)

Name = Literal["paint", "solar_cell", "foil", "metal", "regolith"]
MATERIALS = {
    "paint": PAINT_WHITE,
    "solar_cell": SOLAR_CELL,
    "foil": FOIL_SILVER,
    "metal": BRUSHED_METAL,
    "regolith": REGOLITH,
}
KEPT = (SOLAR_CELL, GLASS)
"""Nobody wraps solar cells and lenses: parts of these materials stay as they are, but under regolith."""


def in_one_material(parts: list[Part], name: Name, studio: Studio) -> list[Part]:
    """The parts with their surfaces replaced, and sheets of the new material on their large flat sides."""
    material = MATERIALS[name]
    kept = [part for part in parts if part.material in KEPT and name != "regolith"]
    bare = [replace(part, material=material, charts=(), colours=None) for part in parts if part not in kept]
    return kept + [
        replace(part, charts=dressed(part.mesh, material, studio, studio.texel_m)) for part in gathered(bare)
    ]
