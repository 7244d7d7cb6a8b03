"""Parts with charts: for families, and for parts of which only the material is known (mesh files, bodies in
one material).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Literal

import numpy as np
import trimesh

from polhode.geometry.lie import Array, Ints
from polhode.simulation.bodies.part import Chart, Part, merge_uniform_parts
from polhode.simulation.bodies.solids import Revolved, flat_facets, flat_regions
from polhode.simulation.bodies.textures import collage, drawn
from polhode.simulation.bodies.textures.canvas import Draw, chart_of_facet, charts_around
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material

GENERATORS: dict[str, ModuleType] = {"drawn": drawn, "collage": collage}
"""The texture generators by ``body.texture``: modules with the same functions that return a Draw."""


@dataclass(frozen=True)
class PartBuilder:
    """Makes parts with charts for one body."""

    textures: ModuleType
    rng: np.random.Generator
    """For shapes and the choice of sheets: independent of the generator"""
    texture_rng: np.random.Generator
    """For the sheets themselves"""
    texel_m: float

    def flat_part(
        self,
        mesh: trimesh.Trimesh,
        material: Material,
        sheets: Draw | Sequence[Draw | None],
        name: str,
        density_factor: float = 1.0,
        down_G: Array | None = None,
    ) -> Part:
        """A part with a chart on each flat face of at least twelve texels.

        One sheet for all faces, or one for each side of a box by its outward normal, in turns for -x, +x, -y,
        +y, -z, +z, and none for its bevels. Rows of the charts run along down_G (3,) unless a face is
        perpendicular to it.
        """
        charts = []
        smallest_m = 12 * self.texel_m
        for faces in flat_facets(mesh):
            normal = np.asarray(mesh.face_normals[faces[0]])
            axis = int(np.argmax(np.abs(normal)))
            if not isinstance(sheets, Sequence):
                draw: Draw | None = sheets
            elif abs(normal[axis]) > 0.9:
                draw = sheets[(2 * axis + int(normal[axis] > 0)) % len(sheets)]
            else:
                draw = None
            large = mesh.area_faces[faces].sum() >= smallest_m**2
            if draw is None or not large:
                continue
            if np.ptp(mesh.triangles[faces].reshape(-1, 3), axis=0).max() < smallest_m:
                continue
            down = None
            if down_G is not None and abs(normal @ down_G) < 0.7:
                down = down_G - (down_G @ normal) * normal
            charts.append(chart_of_facet(mesh, faces, self.texel_m, draw, self.texture_rng, down))
        return Part(mesh, material, tuple(charts), density_factor, name)

    def revolved_part(
        self,
        solid: Revolved,
        walls: list[tuple[int, int, Draw]],
        material: Material,
        name: str,
        density_factor: float = 1.0,
    ) -> Part:
        """A solid of revolution with charts around its walls (first and last profile point, sheet)."""
        charts = [
            chart
            for first, last, draw in walls
            for chart in charts_around(solid, first, last, self.texel_m, draw, self.texture_rng)
        ]
        return Part(solid.mesh, material, tuple(charts), density_factor, name)


MIN_SIDE_TEXELS = 24
"""Sides smaller than the square of this have no chart, only the solid texture."""
TEXELS = 1.3e6
"""On the whole surface of a body."""
MATERIALS = {
    "paint": mat.PAINT_WHITE,
    "solar_cell": mat.SOLAR_CELL,
    "foil": mat.FOIL_SILVER,
    "metal": mat.BRUSHED_METAL,
    "regolith": mat.REGOLITH,
}


def charts_for_mesh(
    mesh: trimesh.Trimesh, material: Material, builder: PartBuilder
) -> tuple[tuple[Chart, Ints], ...]:
    """Charts that suit the material for the large flat sides of a mesh."""
    textures, texel_m = builder.textures, builder.texel_m
    if material.specular == mat.REGOLITH.specular and material.roughness == mat.REGOLITH.roughness:
        return ()
    if material.crease > 0:
        draw = textures.blanket(material)
    elif material.specular > 0.2:
        draw = textures.machined_plate()
    elif material.albedo <= mat.SOLAR_CELL.albedo and material.roughness < 0.3:
        if material.grain == 0:
            return ()
        draw = textures.cells(46)
    else:
        draw = textures.panel(material.albedo, 0.6)
    charts = []
    for faces in flat_regions(mesh, (MIN_SIDE_TEXELS * texel_m) ** 2):
        corners = mesh.triangles[faces].reshape(-1, 3)
        width = mesh.area_faces[faces].sum() / np.ptp(corners, axis=0).max()
        if width > 0.4 * MIN_SIDE_TEXELS * texel_m:
            charts.append(chart_of_facet(mesh, faces, texel_m, draw, builder.texture_rng))
    return tuple(charts)


def texel_size_for(area_m2: float) -> float:
    """Size of a texel [m] for a body's surface."""
    return float(np.sqrt(area_m2 / TEXELS))


def override_material(
    parts: list[Part], name: Literal["paint", "solar_cell", "foil", "metal", "regolith"], builder: PartBuilder
) -> list[Part]:
    """The parts with their material replaced, and charts that suit it on their large flat sides.

    Cells and glass remain, except under regolith.
    """
    material = MATERIALS[name]
    kept = [p for p in parts if p.material in (mat.SOLAR_CELL, mat.GLASS) and name != "regolith"]
    bare = [replace(p, material=material, charts=(), colours=None) for p in parts if p not in kept]
    covered = merge_uniform_parts(bare)
    return kept + [replace(p, charts=charts_for_mesh(p.mesh, material, builder)) for p in covered]
