"""The families by name; ``polhode.config.scene`` and ``polhode.config.train`` list them, too."""

from collections.abc import Callable

from polhode.simulation.bodies.families.asteroid import asteroid_parts
from polhode.simulation.bodies.families.bus import bus_parts
from polhode.simulation.bodies.families.cubesat import cubesat_parts
from polhode.simulation.bodies.families.dish import dish_parts
from polhode.simulation.bodies.families.free_flyer import free_flyer_parts
from polhode.simulation.bodies.families.truss import truss_parts
from polhode.simulation.bodies.families.upper_stage import upper_stage_parts
from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.textures.part_builder import PartBuilder

FAMILIES: dict[str, Callable[[float, PartBuilder], list[Part]]] = {
    "free_flyer": free_flyer_parts,
    "bus": bus_parts,
    "upper_stage": upper_stage_parts,
    "dish": dish_parts,
    "truss": truss_parts,
    "cubesat": cubesat_parts,
    "asteroid": asteroid_parts,
}
"""Parts by size [m] and texture generator."""
TEXELS = {"upper_stage": 950.0, "dish": 700.0, "truss": 900.0}
"""Texels along ``size_m``, otherwise 440: about two per pixel if the body fills an image of 640x480."""
GRAIN_M = {"free_flyer": 0.22, "upper_stage": 0.5, "dish": 0.5, "truss": 0.7}
"""Size for which the materials' textures are made, otherwise 0.3 m; they scale with the body."""
