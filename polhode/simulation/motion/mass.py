"""Mass properties of the target: from the densities of its parts, or as given."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import Body


@dataclass(frozen=True)
class MassDistribution:
    """Mass properties in G; principal moments sorted, greatest first."""

    com_G: Array
    """(3,) [m]"""
    J_G: Array
    """(3, 3) about the centre of mass, axes of G [kg m^2]"""
    moments: Array
    """(3,) [kg m^2]"""
    R_GP: Array
    """(3, 3) right-handed"""
    mass_kg: float


def mass_distribution(mass: config.Mass, body: Body) -> MassDistribution:
    """Mass properties of a body: what the scene does not give follows from the densities of its parts.

    Parts without a density by name have ``density_kg_m3`` times their own factor.
    ``mass_kg`` scales all densities alike. Raises InputError for an unknown part or an impossible inertia.
    """
    names = [part.name for part in body.parts]
    for name in mass.part_density_kg_m3:
        if name not in names:
            raise InputError(
                f"scene.mass.part_density_kg_m3: the body has no part '{name}', only {', '.join(names)}"
            )
    densities = [
        mass.part_density_kg_m3.get(part.name, mass.density_kg_m3 * part.density_factor)
        for part in body.parts
    ]
    masses_kg = np.array(densities) * [part.volume_m3 for part in body.parts]
    total_kg = float(masses_kg.sum())
    scale = 1.0 if mass.mass_kg is None else mass.mass_kg / total_kg
    masses_kg = masses_kg * scale
    centres_G = np.stack([part.com_G for part in body.parts])
    com_G = masses_kg @ centres_G / masses_kg.sum()
    J_G = np.zeros((3, 3))
    for part, m, d in zip(body.parts, masses_kg, centres_G - com_G, strict=True):
        J_G += m / part.volume_m3 * part.inertia_per_density + m * (d @ d * np.eye(3) - np.outer(d, d))
    if mass.com_m is not None:
        com_G = np.array(mass.com_m)
    if mass.inertia_kg_m2 is not None:
        J_G = np.array(mass.inertia_kg_m2)
        if not np.allclose(J_G, J_G.T, rtol=0, atol=1e-9 * np.abs(J_G).max()):
            raise InputError("scene.mass.inertia_kg_m2 is not symmetric: give the full 3x3 matrix")
        low, middle, high = np.linalg.eigvalsh(J_G)
        if low <= 0 or low + middle < high * (1 - 1e-9):
            raise InputError(
                f"scene.mass.inertia_kg_m2: no body has the principal moments {low:.4g}, {middle:.4g}, "
                f"{high:.4g}; they must be positive and the greatest at most the sum of the others"
            )
    return MassDistribution(com_G, J_G, *principal_axes(J_G), total_kg * scale)


def principal_axes(J: ArrayLike) -> tuple[Array, Array]:
    """Inertia (3, 3) -> moments (3,) sorted from the greatest, R_GP (3, 3) right-handed.

    Of the four equivalent triads, which differ by half-turns, the one closest to the axes of G.
    """
    values, vectors = np.linalg.eigh(np.asarray(J, dtype=np.float64))
    R = vectors[:, ::-1] * np.sign(np.linalg.det(vectors[:, ::-1]))
    turns = [np.diag(d) for d in ([1.0, 1, 1], [1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])]
    R_GP = max((R @ turn for turn in turns), key=lambda candidate: float(np.trace(candidate)))
    return values[::-1].copy(), R_GP
