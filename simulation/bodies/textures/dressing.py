"""Drawings for the flat sides of a mesh that has a material and nothing else."""

import numpy as np
import trimesh

from polhode.records import Ints
from polhode.simulation.bodies.parts.facets import flat_regions
from polhode.simulation.bodies.parts.part import Chart
from polhode.simulation.bodies.textures.canvas import Draw, chart_of_facet
from polhode.simulation.bodies.textures.studio import Artist, Studio
from polhode.simulation.surface.materials import REGOLITH, SOLAR_CELL, Material

SMALLEST_TEXELS = 24
"""Sides that are smaller than the square of this keep the solid texture."""
TEXELS = 1.3e6
"""On the whole surface of a body."""
CELL_TEXELS = 46


def sheet_for(material: Material, artist: Artist) -> Draw | None:
    """The sheet that fits a material, or none."""
    if material.specular == REGOLITH.specular and material.roughness == REGOLITH.roughness:
        return None
    if material.crease > 0:
        return artist.blanket(material)
    if material.specular > 0.2:
        return artist.machined_plate()
    if material.albedo <= SOLAR_CELL.albedo and material.roughness < 0.3:
        return artist.cells(CELL_TEXELS) if material.grain > 0 else None
    return artist.panel(material.albedo, 0.6)


def dressed(
    mesh: trimesh.Trimesh, material: Material, studio: Studio, texel_m: float
) -> tuple[tuple[Chart, Ints], ...]:
    """Charts for the large flat sides of a mesh."""
    draw = sheet_for(material, studio.artist)
    if draw is None:
        return ()
    charts = []
    for faces in flat_regions(mesh, (SMALLEST_TEXELS * texel_m) ** 2):
        corners = mesh.triangles[faces].reshape(-1, 3)
        narrow = mesh.area_faces[faces].sum() / np.ptp(corners, axis=0).max()
        if narrow > 0.4 * SMALLEST_TEXELS * texel_m:
            charts.append(chart_of_facet(mesh, faces, texel_m, draw, studio.ink))
    return tuple(charts)


def texel_for(area_m2: float) -> float:
    """Size of a texel [m] for a body's surface."""
    return float(np.sqrt(area_m2 / TEXELS))
