"""Mass properties of closed, open and flat meshes at unit density, combined by name."""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from polhode.lie import Array

SHEET_THICKNESS = 0.01
"""Thickness of a flat open piece, relative to the root of its area."""


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


def masses_by_name(parts: list[tuple[str, trimesh.Trimesh, float]]) -> list[PartMass]:
    """Mass properties of each name, from (name, mesh, density factor) of parts in any number."""
    named: dict[str, list[PartMass]] = {}
    for name, mesh, factor in parts:
        named.setdefault(name, []).extend(_pieces(name, mesh, factor))
    return [_joined(name, masses) for name, masses in named.items()]


def _pieces(name: str, mesh: trimesh.Trimesh, factor: float) -> list[PartMass]:
    """A closed mesh as a whole; an open one by pieces: closed ones, convex hulls of open ones, sheets."""
    if _is_solid(mesh):
        return [_solid(name, mesh, factor)]
    pieces = mesh.split(only_watertight=False)
    return [_piece(name, piece, factor) for piece in pieces] or [_piece(name, mesh, factor)]


def _piece(name: str, piece: trimesh.Trimesh, factor: float) -> PartMass:
    if _is_solid(piece):
        return _solid(name, piece, factor)
    try:
        volume = float(ConvexHull(piece.vertices).volume)
    except QhullError:
        return _sheet(name, piece, factor)
    thin = volume < SHEET_THICKNESS * piece.area**1.5
    return _sheet(name, piece, factor) if thin else _solid(name, piece.convex_hull, factor)


def _is_solid(mesh: trimesh.Trimesh) -> bool:
    """Closed, of consistent winding, and not a folded sheet without volume."""
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        return False
    # trimesh's volume divides by zero on a folded sheet.
    a, b, c = (mesh.triangles[:, k] for k in range(3))
    volume = float(np.einsum("fk,fk->", np.cross(a, b), c)) / 6.0
    return bool(abs(volume) > 1e-9 * mesh.area**1.5)


def _solid(name: str, mesh: trimesh.Trimesh, factor: float) -> PartMass:
    own = mesh.mass_properties
    # A closed piece with inverted winding has volume and inertia of the opposite sign.
    sign = -1.0 if own.volume < 0 else 1.0
    return PartMass(
        name, sign * float(own.volume), np.asarray(own.center_mass), sign * np.asarray(own.inertia), factor
    )


def _sheet(name: str, mesh: trimesh.Trimesh, factor: float) -> PartMass:
    """A thin sheet: each face is weighted by its area."""
    area = np.asarray(mesh.area_faces)
    thickness = SHEET_THICKNESS * np.sqrt(area.sum())
    com = area @ mesh.triangles_center / area.sum()
    corners = mesh.triangles - com
    # Second moment of a triangle about a point: area / 12 (sum of the corners' + that of the sum).
    total = corners.sum(axis=1)
    second = np.einsum("f,fci,fcj->ij", area, corners, corners) + np.einsum("f,fi,fj->ij", area, total, total)
    second = thickness * second / 12.0
    across = np.linalg.eigh(second)[1][:, 0]
    second += area.sum() * thickness**3 / 12.0 * np.outer(across, across)
    inertia = np.trace(second) * np.eye(3) - second
    return PartMass(name, float(area.sum() * thickness), com, inertia, factor)


def _joined(name: str, masses: list[PartMass]) -> PartMass:
    weight, com, inertia = combined_mass(masses, [mass.density_factor for mass in masses])
    factor = weight / sum(mass.volume_m3 for mass in masses)
    return PartMass(name, weight / factor, com, inertia / factor, factor)


def combined_mass(masses: list[PartMass], factors: list[float]) -> tuple[float, Array, Array]:
    """Weighted volume [m^3], centre of mass (3,) [m] and inertia about it (3, 3) [m^5] of several masses."""
    weights = np.array([mass.volume_m3 * factor for mass, factor in zip(masses, factors, strict=True)])
    com = weights @ np.stack([mass.com_G for mass in masses]) / weights.sum()
    inertia = np.zeros((3, 3))
    for mass, weight, factor in zip(masses, weights, factors, strict=True):
        d = mass.com_G - com
        inertia += factor * mass.inertia_per_density + weight * (d @ d * np.eye(3) - np.outer(d, d))
    return float(weights.sum()), np.asarray(com), inertia
