"""Charts for parts of which only the material is known: pieces of mesh files, bodies in one material."""

from dataclasses import replace
from typing import Literal

import numpy as np
import trimesh

from polhode.records import Ints
from polhode.simulation.bodies.parts.facets import flat_regions
from polhode.simulation.bodies.parts.part import Chart, Part, merge_uniform_parts
from polhode.simulation.bodies.textures.canvas import Draw, chart_of_facet
from polhode.simulation.bodies.textures.part_builder import PartBuilder, TextureGenerator
from polhode.simulation.surface.materials import (
    BRUSHED_METAL,
    FOIL_SILVER,
    GLASS,
    PAINT_WHITE,
    REGOLITH,
    SOLAR_CELL,
    Material,
)

MIN_SIDE_TEXELS = 24
"""Sides smaller than the square of this have no chart, only the solid texture."""
TEXELS = 1.3e6
"""On the whole surface of a body."""
CELL_TEXELS = 46


Name = Literal["paint", "solar_cell", "foil", "metal", "regolith"]
MATERIALS = {
    "paint": PAINT_WHITE,
    "solar_cell": SOLAR_CELL,
    "foil": FOIL_SILVER,
    "metal": BRUSHED_METAL,
    "regolith": REGOLITH,
}
KEPT = (SOLAR_CELL, GLASS)
"""Parts of these materials keep them, except under regolith."""


def sheet_for_material(material: Material, textures: TextureGenerator) -> Draw | None:
    """The sheet that suits a material, or None."""
    if material.specular == REGOLITH.specular and material.roughness == REGOLITH.roughness:
        return None
    if material.crease > 0:
        return textures.blanket(material)
    if material.specular > 0.2:
        return textures.machined_plate()
    if material.albedo <= SOLAR_CELL.albedo and material.roughness < 0.3:
        return textures.cells(CELL_TEXELS) if material.grain > 0 else None
    return textures.panel(material.albedo, 0.6)


def charts_for_mesh(
    mesh: trimesh.Trimesh, material: Material, builder: PartBuilder, texel_m: float
) -> tuple[tuple[Chart, Ints], ...]:
    """Charts for the large flat sides of a mesh."""
    draw = sheet_for_material(material, builder.textures)
    if draw is None:
        return ()
    charts = []
    for faces in flat_regions(mesh, (MIN_SIDE_TEXELS * texel_m) ** 2):
        corners = mesh.triangles[faces].reshape(-1, 3)
        narrow = mesh.area_faces[faces].sum() / np.ptp(corners, axis=0).max()
        if narrow > 0.4 * MIN_SIDE_TEXELS * texel_m:
            charts.append(chart_of_facet(mesh, faces, texel_m, draw, builder.texture_rng))
    return tuple(charts)


def texel_size_for(area_m2: float) -> float:
    """Size of a texel [m] for a body's surface."""
    return float(np.sqrt(area_m2 / TEXELS))


def override_material(parts: list[Part], name: Name, builder: PartBuilder) -> list[Part]:
    """The parts with their material replaced, and charts that suit it on their large flat sides."""
    material = MATERIALS[name]
    kept = [part for part in parts if part.material in KEPT and name != "regolith"]
    bare = [replace(part, material=material, charts=(), colours=None) for part in parts if part not in kept]
    return kept + [
        replace(part, charts=charts_for_mesh(part.mesh, material, builder, builder.texel_m))
        for part in merge_uniform_parts(bare)
    ]
