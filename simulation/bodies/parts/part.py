"""Bodies: parts with a material each, and charts on their flat faces."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.lie import Array
from polhode.records import Ints
from polhode.simulation.bodies.parts.facets import smooth_corner_normals
from polhode.simulation.bodies.parts.file_colours import FileColours
from polhode.simulation.bodies.parts.mass import PartMass, combined_mass, masses_by_name
from polhode.simulation.surface.materials import Material

SLOPE_STEP = 0.01
"""Slope of a chart's relief for one count of ``Chart.slope``."""


@dataclass(frozen=True)
class Chart:
    """A texture on a flat face: ``image[row, column]`` is the reflectance at
    ``origin_G + column * texel_m * right_G + row * texel_m * down_G``."""

    origin_G: Array
    """(3,) centre of the first texel [m]"""
    right_G: Array
    """(3,) unit"""
    down_G: Array
    """(3,) unit"""
    texel_m: float
    image: NDArray[np.float32]
    """(h, w) reflectance"""
    slope: NDArray[np.int8] | None = None
    """(h, w, 2) slope of the relief to the right and down, in SLOPE_STEP; flat when absent"""
    layer: NDArray[np.uint8] | None = None
    """(h, w) 0: the part's material; k: materials[k - 1]"""
    materials: tuple[Material, ...] = ()

    def moved(self, X: Array) -> "Chart":
        """The chart after the rigid transform (4, 4) of its part."""
        R = X[:3, :3]
        return replace(
            self, origin_G=R @ self.origin_G + X[:3, 3], right_G=R @ self.right_G, down_G=R @ self.down_G
        )


@dataclass(frozen=True)
class Part:
    """A closed mesh of one material; ``charts`` lists charts with the faces that each covers."""

    mesh: trimesh.Trimesh
    material: Material
    charts: tuple[tuple[Chart, Ints], ...] = ()
    density_factor: float = 1.0
    """Density relative to the scene's."""
    name: str = "body"
    """Name by which a scene gives its density; parts of one name are one item."""
    colours: FileColours | None = None
    """Colours of a mesh file."""

    def moved(self, X: Array) -> "Part":
        """The part after the rigid transform (4, 4)."""
        mesh = self.mesh.copy()
        mesh.apply_transform(X)
        return replace(self, mesh=mesh, charts=tuple((chart.moved(X), faces) for chart, faces in self.charts))


@dataclass(frozen=True)
class Body:
    """A target in G: the union of its parts, ready to be rendered. F faces."""

    mesh: trimesh.Trimesh
    corner_normals: Array
    """(F, 3, 3) unit normal at each corner: averaged over smooth edges, flat over sharp ones"""
    face_material: Ints
    """(F,) index into materials"""
    materials: tuple[Material, ...]
    face_chart: Ints
    """(F,) index into charts, -1: none"""
    charts: tuple[Chart, ...]
    chart_layers: Ints
    """(charts, layers) index into materials of a chart's layers 1, 2, ..."""
    colours: FileColours | None
    """Colours from a mesh file, for all faces"""
    texture_scale: float
    """Factor on the lengths of the materials' textures"""
    volume_m3: float
    """Sum over the parts, each times its density factor"""
    com_G: Array
    """(3,) centre of mass [m], density factors included"""
    inertia_per_density: Array
    """(3, 3) inertia about com_G, axes of G, at a density of 1 kg/m^3 times the factors [m^5]"""
    parts: tuple[PartMass, ...]
    """One entry a name, in order of first appearance"""

    @property
    def radius_m(self) -> float:
        """Radius around G's origin that contains the whole body [m]."""
        return float(np.linalg.norm(self.mesh.vertices, axis=1).max())


def assemble(parts: list[Part], texture_scale: float = 1.0) -> Body:
    """Join parts into a body; the mass of overlapping parts is counted twice."""
    parts = merge_uniform_parts(parts)
    drawn = [(part, chart) for part in parts for chart, _ in part.charts]
    every = [part.material for part in parts] + [m for _, chart in drawn for m in chart.materials]
    materials = tuple(dict.fromkeys(every))
    index = {material: i for i, material in enumerate(materials)}
    layers = np.zeros((len(drawn), max((len(chart.materials) for _, chart in drawn), default=0)), np.int64)
    face_material, face_chart, count = [], [], 0
    for part in parts:
        face_material.append(np.full(len(part.mesh.faces), index[part.material]))
        of_part = np.full(len(part.mesh.faces), -1)
        for chart, faces in part.charts:
            of_part[faces] = count
            layers[count, : len(chart.materials)] = [index[m] for m in chart.materials]
            count += 1
        face_chart.append(of_part)
    masses = masses_by_name([(part.name, part.mesh, part.density_factor) for part in parts])
    volume, com, inertia = combined_mass(masses, [mass.density_factor for mass in masses])
    coloured = any(part.colours is not None for part in parts)
    return Body(
        mesh=join([part.mesh for part in parts]),
        corner_normals=np.concatenate([smooth_corner_normals(part.mesh) for part in parts]),
        face_material=np.concatenate(face_material),
        materials=materials,
        face_chart=np.concatenate(face_chart),
        charts=tuple(chart for _, chart in drawn),
        chart_layers=layers,
        colours=FileColours.joined([(part.colours, len(part.mesh.faces)) for part in parts])
        if coloured
        else None,
        texture_scale=texture_scale,
        volume_m3=volume,
        com_G=com,
        inertia_per_density=inertia,
        parts=tuple(masses),
    )


def merge_uniform_parts(parts: list[Part]) -> list[Part]:
    """The parts, with those that differ only in their meshes merged: few large meshes are fast."""
    alike: dict[tuple[str, Material, float], list[Part]] = {}
    kept = []
    for part in parts:
        if part.charts or part.colours is not None:
            kept.append(part)
        else:
            alike.setdefault((part.name, part.material, part.density_factor), []).append(part)
    joined = [replace(group[0], mesh=join([part.mesh for part in group])) for group in alike.values()]
    return kept + joined


def join(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several, vertices unmerged, without colours."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False
    )


def describe(body: Body) -> str:
    """Description in one line: extents [m], faces, charts, materials, and the parts by volume [m^3]."""
    sides = " x ".join(f"{side:.3g}" for side in np.ptp(np.asarray(body.mesh.vertices), axis=0))
    ordered = sorted(body.parts, key=lambda part: -part.volume_m3)
    listed = [f"{part.name} {part.volume_m3:.3g} m^3" for part in ordered[:6]]
    if len(ordered) > 6:
        listed.append(f"{len(ordered) - 6} more")
    return (
        f"body {sides} m along x, y, z; {len(body.mesh.faces)} faces, {len(body.charts)} drawings, "
        f"{len(body.materials)} materials; parts: {', '.join(listed)}"
    )
