"""What uniform density says of what the motion does not tell (thesis 3.3): assumed, and marked as assumed.

The user gives the mass or a density. The volume and the uniform inertia are those of the mesh, or of its
convex hull where the mesh is open. The inertia that the motion determines up to scale is scaled by them.
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from polhode.config.backend import Backend
from polhode.lie import Array
from polhode.mapping.mesh_geometry import volume_moments
from polhode.mapping.visibility import Caster
from polhode.pipeline.run_directory.summary_parts import Assumed
from polhode.records import MassProperties, SurfaceModel

LEAST_COVERAGE = 0.6
"""Share of the directions from the middle in which there is a surface; below, no volume is told."""
DIRECTIONS = 400
NEARLY_CLOSED = 0.97


@dataclass(frozen=True)
class Solid:
    """A body of density 1."""

    volume_m3: float
    com_G: Array
    """(3,) [m]"""
    inertia: Array
    """(3, 3) about com_G, axes of G, for a density of 1 kg/m^3 [m^5]"""
    words: str


def assumed_properties(
    mass: MassProperties, surface: SurfaceModel, config: Backend
) -> tuple[Assumed | None, list[str]]:
    """The assumed part of the summary, and warnings; (None, []) when neither mass nor density is given."""
    if config.mass_kg is None and config.density_kg_m3 is None:
        return None, []
    solid, reason = solid_of(surface.mesh)
    if solid is None:
        return None, [f"nothing is assumed from the given mass or density: {reason}"]
    if config.mass_kg is not None:
        kilograms, density = config.mass_kg, config.mass_kg / solid.volume_m3
        source = f"mass {kilograms:.6g} kg as given (backend.mass_kg)"
    else:
        assert config.density_kg_m3 is not None
        density, kilograms = config.density_kg_m3, config.density_kg_m3 * solid.volume_m3
        source = f"mass {kilograms:.4g} kg: density {density:.6g} kg/m^3 as given (backend.density_kg_m3)"
    known, uniform = mass.identifiable, density * solid.inertia
    shape_known = known.k1 and known.k2 and known.axes
    # the same trace: the sum of the mean square distances does not depend on the axes
    scale = np.trace(uniform) / np.trace(mass.J_G)
    inertia = scale * mass.J_G if shape_known else uniform
    words = [solid.words, source]
    words.append(
        "inertia: ratios and axes as the motion determines them, scaled to the trace of uniform density"
        if shape_known
        else "inertia: uniform density, as the motion does not determine all ratios and axes"
    )
    moments, R_GP = principal_axes(uniform)
    com_G = None if known.com else _completed_com(mass, solid)
    for name, determined in (("k1", known.k1), ("k2", known.k2), ("axes", known.axes), ("com", known.com)):
        if not determined:
            words.append(f"{name}: uniform density, as the motion does not determine it")
    return Assumed(
        words=words,
        volume_m3=solid.volume_m3,
        density_kg_m3=density,
        mass_kg=kilograms,
        inertia_kg_m2=_matrix(inertia),
        com_G=None if com_G is None else (com_G[0], com_G[1], com_G[2]),
        k1=None if known.k1 else float(np.log(moments[0] / moments[1])),
        k2=None if known.k2 else float(np.log(moments[1] / moments[2])),
        R_GP=None if known.axes else _matrix(R_GP),
    ), []


def solid_of(mesh: trimesh.Trimesh, caster: Caster | None = None) -> tuple[Solid | None, str]:
    """The mesh as a solid body, or why it is none.

    A closed mesh as it is; an open one by its convex hull, if it surrounds its middle. ``caster``: of the
    mesh, if there is one already.
    """
    if len(mesh.faces) < 4:
        return None, "there is no surface"
    if mesh.is_volume:
        return solid_body(mesh, "volume of the mesh, which is closed"), ""
    hull = mesh.convex_hull
    share = coverage(caster or Caster(mesh), np.asarray(hull.center_mass))
    if share < LEAST_COVERAGE:
        return None, f"the surface is open and covers only {share:.0%} of the directions from its middle"
    filled = "" if share > NEARLY_CLOSED else f" (it covers {share:.0%} of the directions from its middle)"
    return solid_body(
        hull, f"volume of the mesh's convex hull, as the mesh is open{filled}: an upper bound of that volume"
    ), ""


def coverage(caster: Caster, middle_G: Array) -> float:
    """Share of the directions from a point in which the mesh stands."""
    n = np.arange(DIRECTIONS) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * n / DIRECTIONS), np.pi * (1.0 + 5.0**0.5) * n
    direction = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
    _, face = caster.first(middle_G, direction)
    return float(np.mean(face >= 0))


def principal_axes(inertia: Array) -> tuple[Array, Array]:
    """Moments (3,) descending, and R_GP (3, 3), right-handed."""
    values, vectors = np.linalg.eigh(inertia)
    R_GP = vectors[:, ::-1].copy()
    R_GP[:, 2] *= np.sign(np.linalg.det(R_GP))
    return values[::-1], R_GP


def solid_body(mesh: trimesh.Trimesh, words: str) -> Solid:
    """What a mesh encloses."""
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    # about a point within: far from the origin the products would cancel
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    sums = volume_moments(vertices - middle, np.asarray(mesh.faces, dtype=np.int64))
    # faces that are wound inwards give a negative volume
    volume, first, second = np.sign(sums[0]) * sums[0], np.sign(sums[0]) * sums[1:4], np.zeros((3, 3))
    second[np.triu_indices(3)] = np.sign(sums[0]) * sums[4:]
    second += np.triu(second, 1).T
    centre = first / volume
    about = second - volume * np.outer(centre, centre)
    return Solid(float(volume), middle + centre, np.trace(about) * np.eye(3) - about, words)


def _completed_com(mass: MassProperties, solid: Solid) -> Array:
    """The estimate, its undetermined components along the principal axes taken from the solid."""
    lost = mass.R_GP[:, ~mass.identifiable.com_P]
    return np.asarray(mass.com_G + lost @ (lost.T @ (solid.com_G - mass.com_G)))


def _matrix(values: Array) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(a), float(b), float(c)) for a, b, c in values)
