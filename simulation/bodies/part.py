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
    com_G: Array
    """(3,) centre of mass of uniform density [m]"""
    inertia_per_density: Array
    """(3, 3) inertia of density 1 kg/m^3 about com_G, axes of G [m^5]"""

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
    volume, com, inertia = _mass_of_parts(parts)
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
    )


def join(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several, vertices unmerged, without colours."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False
    )


def _mass_of_parts(parts: list[Part]) -> tuple[float, Array, Array]:
    """Volume [m^3], centre of mass [m] and inertia per density [m^5]; open parts weigh as their hulls."""
    masses, coms, inertias = [], [], []
    for part in parts:
        solid = part.mesh if part.mesh.is_volume else part.mesh.convex_hull
        properties = solid.mass_properties
        masses.append(properties.volume * part.density_factor)
        coms.append(np.asarray(properties.center_mass))
        inertias.append(np.asarray(properties.inertia) * part.density_factor)
    total = float(np.sum(masses))
    com = np.sum([m * c for m, c in zip(masses, coms, strict=True)], axis=0) / total
    inertia = np.zeros((3, 3))
    for m, c, own in zip(masses, coms, inertias, strict=True):
        d = c - com
        inertia += own + m * (d @ d * np.eye(3) - np.outer(d, d))
    return total, np.asarray(com), inertia


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
