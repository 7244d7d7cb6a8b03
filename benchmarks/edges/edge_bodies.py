"""Bodies for trials of edge trackers: plain solids, and the simulator's own in matte grey or as they are."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.edges.edge_solids import SOLIDS
from polhode.config import scene as config
from polhode.errors import InputError
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.bodies.parts.facets import SMOOTH_BELOW_DEG
from polhode.simulation.bodies.parts.part import Part, assemble
from polhode.simulation.surface.materials import Material

CREASE_DEG = SMOOTH_BELOW_DEG
"""Faces that share vertices and meet at less than this look like one curved surface."""
MATTE = Material(0.5, 0.0, 1.0)
"""A diffuse grey without any texture: only shape makes edges."""


@dataclass(frozen=True)
class Kind:
    """A body of the simulator as trials use it."""

    family: str
    size_m: float
    seed: int


KINDS = {
    "bus": Kind("bus", 0.42, 1),
    "cubesat": Kind("cubesat", 0.5, 4),
    "truss": Kind("truss", 1.0, 3),
    "upper_stage": Kind("upper_stage", 1.2, 3),
    "free_flyer": Kind("free_flyer", 0.5, 1),
    "dish": Kind("dish", 0.6, 2),
}
"""Bodies of simulation/bodies, 0.6 to 1.2 m over all."""


@dataclass(frozen=True)
class EdgeBody:
    """A body to be seen."""

    name: str
    body: Body
    config: config.Body

    @property
    def mesh(self) -> trimesh.Trimesh:
        """What the rays meet, in G [m]."""
        return self.body.mesh


def edge_body(source: str | Path | trimesh.Trimesh, plain: bool = True, name: str = "mesh") -> EdgeBody:
    """A body by its name (``NAMES``), from a mesh file in metres, or from a mesh in G.

    plain: one matte grey without any texture, so that shape alone makes edges; else the body's own surface
    (paint, cells, foil, stickers), which solids have not. Raises InputError (files).
    """
    described = config.Body(contrast=0.0)
    if isinstance(source, trimesh.Trimesh):
        body = assemble([Part(source, MATTE)])
    elif isinstance(source, str) and source in SOLIDS:
        name, body = source, assemble([Part(SOLIDS[source](), MATTE)])
    elif isinstance(source, str) and source in KINDS:
        kind, name = KINDS[source], source
        described = config.Body.model_validate(
            {"family": kind.family, "size_m": kind.size_m, "seed": kind.seed}
        )
        body = build_body(described, kind.seed)
    elif isinstance(source, Path):
        described, name = config.Body(family="mesh", path=str(source), metres_per_unit=1.0), source.stem
        body = build_body(described, 0)
    else:
        raise InputError(f"{source}: no such body; choose from {', '.join(NAMES)}, or give a mesh file")
    return EdgeBody(name, in_matte(body) if plain else body, described)


def in_matte(body: Body) -> Body:
    """The same shape, of one material."""
    faces = len(body.mesh.faces)
    return replace(
        body,
        face_material=np.zeros(faces, dtype=np.int64),
        materials=(MATTE,),
        face_chart=np.full(faces, -1),
        charts=(),
        chart_layers=np.zeros((0, 0), dtype=np.int64),
        colours=None,
    )


NAMES = (*SOLIDS, *KINDS)
