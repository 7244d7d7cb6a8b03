"""Builds the body that a scene describes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from polhode.config import scene as config
from polhode.simulation.bodies.families.registry import FAMILIES, GRAIN_M, TEXELS
from polhode.simulation.bodies.imported.mesh_file import mesh_file_parts
from polhode.simulation.bodies.parts.part import Body, assemble
from polhode.simulation.bodies.textures.by_material import override_material, texel_size_for
from polhode.simulation.bodies.textures.part_builder import PartBuilder, texture_generator

MESH_GRAIN_M = 0.25
"""The same for mesh files: the side of a cube of the same surface area."""


def build_body(body: config.TargetBody, seed: int) -> Body:
    """Build the target; ``seed`` is used if the description has none. Raises InputError (mesh files)."""
    own = seed if body.seed is None else body.seed
    rng, texture_rng = np.random.default_rng([0xB0D1, own]), np.random.default_rng([0x1A4C, own])
    builder = PartBuilder(
        texture_generator(body.texture), rng, texture_rng, body.size_m / TEXELS.get(body.family, 440.0)
    )
    if body.family == "mesh":
        # Validated by the configuration.
        assert body.path is not None
        assert body.metres_per_unit is not None
        parts = mesh_file_parts(Path(body.path), body.metres_per_unit, builder)
        area_m2 = sum(float(part.mesh.area) for part in parts)
        grain = float(np.sqrt(area_m2 / 6.0)) / MESH_GRAIN_M
        builder = replace(builder, texel_m=texel_size_for(area_m2))
    else:
        parts = FAMILIES[body.family](body.size_m, builder)
        grain = body.size_m / GRAIN_M.get(body.family, 0.3)
    if body.material != "automatic":
        parts = override_material(parts, body.material, builder)
    return assemble(parts, grain)
