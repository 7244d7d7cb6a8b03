"""The body that a mesh encloses, at uniform density 1: volume, centre of mass and inertia.

The mesh itself where it is closed, else its convex hull, if the mesh surrounds its centre.
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from polhode.geometry.lie import Array
from polhode.mapping.visibility import Caster, directions


@dataclass(frozen=True)
class Solid:
    """A body of density 1."""

    volume_m3: float
    com_G: Array
    """(3,) [m]"""
    inertia: Array
    """(3, 3) about com_G, axes of G, for a density of 1 kg/m^3 [m^5]"""
    words: str


def solid_of(mesh: trimesh.Trimesh, caster: Caster | None = None) -> tuple[Solid | None, str]:
    """The mesh as a solid body, or the reason why it is not one.

    A closed mesh as it is; an open one by its convex hull, if it surrounds its centre. ``caster``: of the
    mesh, if available.
    """
    if len(mesh.faces) < 4:
        return None, "there is no surface"
    if mesh.is_volume:
        return solid_body(mesh, "volume of the mesh, which is closed"), ""
    hull = mesh.convex_hull
    share = coverage(caster or Caster(mesh), np.asarray(hull.center_mass))
    # share of the directions from the centre with a surface below which no volume is given
    if share < 0.6:
        return None, f"the surface is open and covers only {share:.0%} of the directions from its centre"
    filled = "" if share > 0.97 else f" (it covers {share:.0%} of the directions from its centre)"
    return solid_body(
        hull, f"volume of the mesh's convex hull, as the mesh is open{filled}: an upper bound of that volume"
    ), ""


def solid_body(mesh: trimesh.Trimesh, words: str) -> Solid:
    """The body that a mesh encloses."""
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    # about a point inside: far from the origin the products would cancel
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    own = trimesh.triangles.mass_properties((vertices - middle)[mesh.faces])
    # faces that are wound inwards give a negative volume
    sign = float(np.sign(own.volume))
    return Solid(sign * float(own.volume), middle + own.center_mass, sign * np.asarray(own.inertia), words)


def principal_axes(inertia: Array) -> tuple[Array, Array]:
    """Moments (3,) descending, and R_GP (3, 3), right-handed."""
    values, vectors = np.linalg.eigh(inertia)
    R_GP = vectors[:, ::-1].copy()
    R_GP[:, 2] *= np.sign(np.linalg.det(R_GP))
    return values[::-1], R_GP


def coverage(caster: Caster, middle_G: Array) -> float:
    """Share of the directions from a point in which a ray hits the mesh."""
    _, face = caster.first(middle_G, directions(400))
    return float(np.mean(face >= 0))
