"""From a scene's description to a body."""

from pathlib import Path

import numpy as np

from polhode.config import scene as config
from polhode.errors import InputError
from simulation.bodies.asteroid import asteroid_parts
from simulation.bodies.bus import bus_parts
from simulation.bodies.free_flyer import free_flyer_parts
from simulation.bodies.mesh_file import mesh_file_parts
from simulation.bodies.part import Body, Part, assemble


def build_body(body: config.Body, seed: int) -> Body:
    """Build the target; ``seed`` serves where the description has none. Raises InputError (mesh files)."""
    rng = np.random.default_rng([0xB0D1, seed if body.seed is None else body.seed])
    return assemble(_parts(body, rng))


def _parts(body: config.Body, rng: np.random.Generator) -> list[Part]:
    match body.family:
        case "free_flyer":
            return free_flyer_parts(body.size_m, rng)
        case "bus":
            return bus_parts(body.size_m, rng)
        case "asteroid":
            return asteroid_parts(body.size_m, rng)
        case "mesh":
            # The section has validated both.
            assert body.path is not None
            assert body.metres_per_unit is not None
            return mesh_file_parts(Path(body.path), body.metres_per_unit, rng)
        case _:
            raise InputError(f"scene.body.family: {body.family} cannot be built yet; choose another family")
