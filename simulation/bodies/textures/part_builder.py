"""Parts with charts, as families build them: texture generator, random numbers, size of a texel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import trimesh

from polhode.lie import Array
from polhode.simulation.bodies.parts.facets import flat_facets
from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.parts.solids import Revolved
from polhode.simulation.bodies.textures import collage, drawn
from polhode.simulation.bodies.textures.canvas import Draw, chart_of_facet, charts_around
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
