"""From a scene's description to a body."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from polhode.config import scene as config
from simulation.bodies.artist import artist_of
from simulation.bodies.asteroid import asteroid_parts
from simulation.bodies.bus import bus_parts
from simulation.bodies.cubesat import cubesat_parts
from simulation.bodies.dish import dish_parts
from simulation.bodies.dressing import texel_for
from simulation.bodies.free_flyer import free_flyer_parts
from simulation.bodies.mesh_file import mesh_file_parts
from simulation.bodies.override import in_one_material
from simulation.bodies.part import Body, Part, assemble
from simulation.bodies.studio import Studio
from simulation.bodies.truss import truss_parts
from simulation.bodies.upper_stage import upper_stage_parts

TEXELS = {
    "free_flyer": 440.0,
    "bus": 420.0,
    "upper_stage": 950.0,
    "dish": 700.0,
    "truss": 900.0,
    "cubesat": 480.0,
}
"""Texels along ``size_m``: about two to a pixel where the whole body fills an image of 640x480."""
GRAINS = {
    "free_flyer": 0.22,
    "bus": 0.3,
    "upper_stage": 0.5,
    "dish": 0.5,
    "truss": 0.7,
    "cubesat": 0.3,
    "asteroid": 0.3,
}
"""Size [m] for which the materials' textures are made; they grow with the body."""


MESH_GRAIN_M = 0.25
"""The same for mesh files: the side of a cube of the same surface."""


def build_body(body: config.Body, seed: int) -> Body:
    """Build the target; ``seed`` serves where the description has none. Raises InputError (mesh files)."""
    own = seed if body.seed is None else body.seed
    rng, ink = np.random.default_rng([0xB0D1, own]), np.random.default_rng([0x1A4C, own])
    texel_m = body.size_m / TEXELS.get(body.family, 440.0)
    scale = body.size_m / GRAINS.get(body.family, body.size_m)
    studio = Studio(artist_of(body.texture), rng, ink, texel_m)
    parts = _parts(body, studio)
    if body.family == "mesh":
        area_m2 = sum(float(part.mesh.area) for part in parts)
        scale, texel_m = float(np.sqrt(area_m2 / 6.0)) / MESH_GRAIN_M, texel_for(area_m2)
    if body.material != "automatic":
        parts = in_one_material(parts, body.material, replace(studio, texel_m=texel_m))
    return assemble(parts, scale)


def _parts(body: config.Body, studio: Studio) -> list[Part]:
    match body.family:
        case "free_flyer":
            return free_flyer_parts(body.size_m, studio)
        case "bus":
            return bus_parts(body.size_m, studio)
        case "upper_stage":
            return upper_stage_parts(body.size_m, studio)
        case "dish":
            return dish_parts(body.size_m, studio)
        case "truss":
            return truss_parts(body.size_m, studio)
        case "cubesat":
            return cubesat_parts(body.size_m, studio)
        case "asteroid":
            return asteroid_parts(body.size_m, studio.rng)
        case "mesh":
            # The section has validated both.
            assert body.path is not None
            assert body.metres_per_unit is not None
            return mesh_file_parts(Path(body.path), body.metres_per_unit, studio)
