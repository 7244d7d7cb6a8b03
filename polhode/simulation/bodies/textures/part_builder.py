"""Parts with charts: for families, and for parts of which only the material is known (mesh files, bodies in
one material).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
import trimesh

from polhode.geometry.lie import Array, Ints
from polhode.simulation.bodies.part import Chart, Part, merge_uniform_parts
from polhode.simulation.bodies.solids import Revolved, flat_facets, flat_regions
from polhode.simulation.bodies.textures import collage, drawn
from polhode.simulation.bodies.textures.canvas import Draw, chart_of_facet, charts_around
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material


def texture_generator(name: Literal["drawn", "collage"]) -> "TextureGenerator":
    """The texture generator that ``body.texture`` names."""
    return drawn if name == "drawn" else collage


class TextureGenerator(Protocol):
    """A texture generator for the surfaces of spacecraft: a module with these functions."""

    def panel(self, base: float, richness: float = ...) -> Draw:
        """An equipment panel of mean reflectance ``base``; richness scales the number of marks."""

    def plain(self, base: float) -> Draw:
        """A painted panel with few marks."""

    def machined_plate(self) -> Draw:
        """Bare metal."""

    def cells(self, cell: int = ...) -> Draw:
        """Solar cells, ``cell`` texels long."""

    def radiator(self) -> Draw:
        """A heat radiator."""

    def blanket(self, foil: Material) -> Draw:
        """A blanket of a foil."""

    def tank_wall(self, base: float) -> Draw:
        """The unrolled wall of a tank; its lower end is the aft one."""

    def ring_wall(self, base: float) -> Draw:
        """The unrolled wall of an interstage or adapter."""

    def nozzle_wall(self) -> Draw:
        """The unrolled wall of a nozzle."""

    def reflector(self, base: float, gores: int) -> Draw:
        """The unrolled face of a dish."""


def sheet_by_side(sheets: Sequence[Draw]) -> Callable[[Array], Draw | None]:
    """One sheet for each side of a box along the axes, from its outward normal (3,); none for its bevels."""

    def choose(normal: Array) -> Draw | None:
        axis = int(np.argmax(np.abs(normal)))
        side = 2 * axis + int(normal[axis] > 0)
        return sheets[side % len(sheets)] if abs(normal[axis]) > 0.9 else None

    return choose


@dataclass(frozen=True)
class PartBuilder:
    """Makes parts with charts for one body."""

    textures: TextureGenerator
    rng: np.random.Generator
    """For shapes and the choice of sheets: independent of the generator"""
    texture_rng: np.random.Generator
    """For the sheets themselves"""
    texel_m: float
    smallest_texels: int = 12
    """Narrower faces have no chart."""

    def flat_part(
        self, mesh: trimesh.Trimesh, material: Material, draw: Draw, name: str, density_factor: float = 1.0
    ) -> Part:
        """A part with a chart on each flat face that is large enough."""
        return self.flat_part_by_side(mesh, material, lambda _: draw, name, density_factor)

    def flat_part_by_side(
        self,
        mesh: trimesh.Trimesh,
        material: Material,
        choose: Callable[[Array], Draw | None],
        name: str,
        density_factor: float = 1.0,
        down_G: Array | None = None,
    ) -> Part:
        """The same with the sheet chosen by the outward normal (3,) of each face, or none.

        Rows of the charts run along down_G (3,) unless a face is perpendicular to it.
        """
        charts = []
        smallest_m = self.smallest_texels * self.texel_m
        for faces in flat_facets(mesh):
            if mesh.area_faces[faces].sum() < smallest_m**2:
                continue
            normal = np.asarray(mesh.face_normals[faces[0]])
            draw = choose(normal)
            if draw is None or np.ptp(mesh.triangles[faces].reshape(-1, 3), axis=0).max() < smallest_m:
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


Name = Literal["paint", "solar_cell", "foil", "metal", "regolith"]
MATERIALS = {
    "paint": mat.PAINT_WHITE,
    "solar_cell": mat.SOLAR_CELL,
    "foil": mat.FOIL_SILVER,
    "metal": mat.BRUSHED_METAL,
    "regolith": mat.REGOLITH,
}
KEPT = (mat.SOLAR_CELL, mat.GLASS)
"""Parts of these materials keep them, except under regolith."""


def sheet_for_material(material: Material, textures: TextureGenerator) -> Draw | None:
    """The sheet that suits a material, or None."""
    if material.specular == mat.REGOLITH.specular and material.roughness == mat.REGOLITH.roughness:
        return None
    if material.crease > 0:
        return textures.blanket(material)
    if material.specular > 0.2:
        return textures.machined_plate()
    if material.albedo <= mat.SOLAR_CELL.albedo and material.roughness < 0.3:
        return textures.cells(46) if material.grain > 0 else None
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
