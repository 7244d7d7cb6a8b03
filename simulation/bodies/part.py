"""What a body is made of: parts with a material each, and charts drawn onto flat faces."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.lie import Array
from polhode.records import Ints
from simulation.materials import Material

SMOOTH_BELOW_DEG = 40.0


@dataclass(frozen=True)
class Chart:
    """A drawing on a flat face: ``image[row, column]`` is the reflectance at
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


@dataclass(frozen=True)
class Part:
    """A closed mesh of one material; ``chart_faces`` maps a chart to the faces that it covers."""

    mesh: trimesh.Trimesh
    material: Material
    charts: tuple[tuple[Chart, Ints], ...] = ()
    density_factor: float = 1.0
    """Density relative to the scene's."""
    name: str = "body"
    """What a scene calls it when it gives a density; parts of one name are one thing."""


@dataclass(frozen=True)
class PartMass:
    """Mass properties of the parts of one name, at density 1 kg/m^3 (``density_factor`` not included)."""

    name: str
    volume_m3: float
    com_G: Array
    """(3,) [m]"""
    inertia_per_density: Array
    """(3, 3) about com_G, axes of G [m^5]"""
    density_factor: float
    """Density relative to the scene's"""


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
        """Radius around G's origin that holds the whole body [m]."""
        return float(np.linalg.norm(self.mesh.vertices, axis=1).max())


def assemble(parts: list[Part]) -> Body:
    """Join parts into a body; the mass of overlapping parts is counted twice."""
    materials = tuple(dict.fromkeys(part.material for part in parts))
    charts: list[Chart] = []
    face_material, face_chart = [], []
    for part in parts:
        n = len(part.mesh.faces)
        face_material.append(np.full(n, materials.index(part.material)))
        of_part = np.full(n, -1)
        for chart, faces in part.charts:
            of_part[faces] = len(charts)
            charts.append(chart)
        face_chart.append(of_part)
    mesh = join([part.mesh for part in parts])
    masses = masses_by_name(parts)
    volume, com, inertia = _together(masses, [mass.density_factor for mass in masses])
    return Body(
        mesh=mesh,
        corner_normals=np.concatenate([smooth_corner_normals(part.mesh) for part in parts]),
        face_material=np.concatenate(face_material),
        materials=materials,
        face_chart=np.concatenate(face_chart),
        charts=tuple(charts),
        volume_m3=volume,
        com_G=com,
        inertia_per_density=inertia,
        parts=tuple(masses),
    )


def join(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several, vertices unmerged, without colours."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False
    )


def masses_by_name(parts: list[Part]) -> list[PartMass]:
    """Mass properties of each name; open parts weigh as their hulls."""
    named: dict[str, list[PartMass]] = {}
    for part in parts:
        solid = part.mesh if part.mesh.is_volume else part.mesh.convex_hull
        own = solid.mass_properties
        mass = PartMass(
            part.name,
            float(own.volume),
            np.asarray(own.center_mass),
            np.asarray(own.inertia),
            part.density_factor,
        )
        named.setdefault(part.name, []).append(mass)
    return [_joined(name, masses) for name, masses in named.items()]


def _joined(name: str, masses: list[PartMass]) -> PartMass:
    weight, com, inertia = _together(masses, [mass.density_factor for mass in masses])
    factor = weight / sum(mass.volume_m3 for mass in masses)
    return PartMass(name, weight / factor, com, inertia / factor, factor)


def _together(masses: list[PartMass], factors: list[float]) -> tuple[float, Array, Array]:
    """Weighted volume [m^3], centre of mass (3,) [m] and inertia about it (3, 3) [m^5] of several masses."""
    weights = np.array([mass.volume_m3 * factor for mass, factor in zip(masses, factors, strict=True)])
    com = weights @ np.stack([mass.com_G for mass in masses]) / weights.sum()
    inertia = np.zeros((3, 3))
    for mass, weight, factor in zip(masses, weights, factors, strict=True):
        d = mass.com_G - com
        inertia += factor * mass.inertia_per_density + weight * (d @ d * np.eye(3) - np.outer(d, d))
    return float(weights.sum()), np.asarray(com), inertia


def smooth_corner_normals(mesh: trimesh.Trimesh) -> Array:
    """Normals per corner (F, 3, 3): mean of the neighbouring faces less than 40 degrees away.

    Faces wound the wrong way count with their sign turned: real meshes mix windings.
    """
    face_normals = np.asarray(mesh.face_normals)
    neighbours = mesh.vertex_faces[mesh.faces]
    n = np.where(neighbours[..., None] >= 0, face_normals[neighbours], 0.0)
    cosine = np.einsum("fcnk,fk->fcn", n, face_normals)
    area = np.where(neighbours >= 0, mesh.area_faces[neighbours], 0.0)
    weight = np.sign(cosine) * area * (np.abs(cosine) > np.cos(np.deg2rad(SMOOTH_BELOW_DEG)))
    total = np.einsum("fcn,fcnk->fck", weight, n)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    flat = np.broadcast_to(face_normals[:, None], total.shape)
    return np.where(length > 0, total / np.where(length > 0, length, 1.0), flat)


def flat_facets(mesh: trimesh.Trimesh) -> list[Ints]:
    """Faces of the same plane, one array per plane, in order of the first face."""
    key = np.round(
        np.column_stack([mesh.face_normals, np.einsum("fk,fk->f", mesh.face_normals, mesh.triangles[:, 0])]),
        5,
    )
    key += 0.0
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.reshape(-1)
    order = dict.fromkeys(group.tolist())
    return [np.flatnonzero(group == g) for g in order]
