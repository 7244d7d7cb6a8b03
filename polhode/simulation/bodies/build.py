"""Builds the body that a scene describes.

The families are also listed in ``polhode.config.scene_settings`` and ``polhode.config.train_settings``.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from polhode.config import scene_settings as config
from polhode.simulation.bodies.families.asteroid import asteroid_parts
from polhode.simulation.bodies.families.bus import bus_parts
from polhode.simulation.bodies.families.cubesat import cubesat_parts
from polhode.simulation.bodies.families.dish import dish_parts
from polhode.simulation.bodies.families.free_flyer import free_flyer_parts
from polhode.simulation.bodies.families.truss import truss_parts
from polhode.simulation.bodies.families.upper_stage import upper_stage_parts
from polhode.simulation.bodies.mesh_file import mesh_file_parts
from polhode.simulation.bodies.part import Body, Part, assemble
from polhode.simulation.bodies.textures.part_builder import (
    GENERATORS,
    PartBuilder,
    override_material,
    texel_size_for,
)


def build_body(body: config.TargetBody, seed: int) -> Body:
    """Build the target; ``seed`` is used if the description has none. Raises InputError (mesh files)."""
    own = seed if body.seed is None else body.seed
    rng = np.random.default_rng([0xB0D1, own])
    texture_rng = np.random.default_rng([0x1A4C, texture_seed(body, seed)])
    texel_m = body.size_m / TEXELS.get(body.family, 440.0)
    builder = PartBuilder(GENERATORS[body.texture], rng, texture_rng, texel_m)
    if body.family == "mesh":
        # Validated by the configuration.
        assert body.path is not None
        assert body.metres_per_unit is not None
        parts = mesh_file_parts(Path(body.path), body.metres_per_unit, builder)
        area_m2 = sum(float(part.mesh.area) for part in parts)
        # As GRAIN_M, of the side of a cube of the same surface area [m].
        grain = float(np.sqrt(area_m2 / 6.0)) / 0.25
        builder = replace(builder, texel_m=texel_size_for(area_m2))
    else:
        parts = FAMILIES[body.family](body.size_m, builder)
        grain = body.size_m / GRAIN_M.get(body.family, 0.3)
    if body.material != "automatic":
        parts = override_material(parts, body.material, builder)
    return assemble(parts, grain)


def texture_seed(body: config.TargetBody, seed: int) -> int:
    """Seed of textures and materials; ``seed`` is used if the description has none."""
    own = seed if body.seed is None else body.seed
    return own if body.texture_seed is None else body.texture_seed


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
