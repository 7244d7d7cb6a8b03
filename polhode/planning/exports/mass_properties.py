"""Mass and inertia for an export, and whether what the user gave fits the mesh.

A motion without known torques determines the inertia only up to scale, and a mass alone does not set that
scale: it takes a length as well. In order of preference the scale comes from the middle moment as given; from
known torques; from uniform density in the volume of the mesh, at the mass as given or estimated; otherwise
the numbers are relative, and the files say so.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, make_pose, transform_points
from polhode.mapping.uniform_solid import Solid, principal_axes
from polhode.planning.exports.options import ExportOptions
from polhode.run_directory.summary_in_words import describe_intervals, possible_com
from polhode.run_directory.summary_schema import Summary
from polhode.runtime.errors import InputError


@dataclass(frozen=True)
class Inertial:
    """Mass and inertia as the files have them, and their origin."""

    mass_kg: float
    com_F: Array
    """(3,) [m]"""
    R_FP: Array
    """(3, 3) principal axes"""
    moments_kg_m2: Array
    """(3,) about the centre of mass, along the axes of P"""
    mass_is: str
    """given, determined, assumed or relative"""
    scale_is: str
    """determined, given, assumed or relative: that of the moments"""
    notes: tuple[str, ...]
    """Origin of each number and what was assumed, a sentence each"""
    restated: tuple[str, ...] = ()
    """Those of the notes that only repeat what the user gave"""

    @property
    def X_FP(self) -> Array:
        """(4, 4)"""
        return make_pose(self.R_FP, self.com_F)


def inertial_of(
    summary: Summary, solid: Solid | None, no_solid: str, X_FG: Array, options: ExportOptions
) -> Inertial | None:
    """In F; None when there is neither an estimate nor a volume.

    ``solid``: the mesh at density 1; ``no_solid``: why there is none.
    """
    found, moment = summary.inertia, options.middle_moment_kg_m2
    mass, mass_is = 1.0, "relative"
    note = "mass: relative, set to 1: the run does not determine it; give it by --mass-kg"
    if options.mass_kg is not None:
        mass, mass_is, note = options.mass_kg, "given", f"mass: {options.mass_kg:g} kg as given"
    elif found is not None and found.mass_kg is not None and found.sigma_mass_kg is not None:
        mass, mass_is = found.mass_kg, "determined"
        note = f"mass: {mass:.6g} kg from the known forces (standard deviation {found.sigma_mass_kg:.2g})"
    elif summary.assumed is not None:
        mass, mass_is = summary.assumed.mass_kg, "assumed"
        note = f"mass: {mass:.6g} kg, from the mass or density that the run was given"
    notes, restated = [note], [note] if mass_is == "given" else []
    uniform_is = "relative" if mass_is == "relative" else "assumed"

    if found is None or summary.R_GP is None or summary.com_G is None:
        if solid is None:
            return None
        moments, R_GP = principal_axes(mass / solid.volume_m3 * solid.inertia)
        com_G, scale_is = solid.com_G, uniform_is
        notes.append(
            f"inertia and centre of mass: assumed, uniform density in the {solid.words}, as the run has no "
            "estimate of them"
        )
    else:
        if moment is not None:
            scale, scale_is = moment, "given"
            note = f"inertia: scaled to the middle moment as given, {moment:g} kg m^2"
            restated.append(note)
        elif found.scale_kg_m2 is not None and found.sigma_scale_kg_m2 is not None:
            scale, scale_is = found.scale_kg_m2, "determined"
            note = (
                f"inertia: scale determined by the known torques, middle moment {scale:.6g} kg m^2 "
                f"(standard deviation {found.sigma_scale_kg_m2:.2g})"
            )
        elif solid is not None:
            # the same trace: the sum of the mean square distances does not depend on the axes
            trace = mass / solid.volume_m3 * float(np.trace(solid.inertia))
            scale, scale_is = trace / float(np.sum(found.moments)), uniform_is
            note = (
                "inertia: ratios and axes by the motion; their scale is assumed, that of uniform density at "
                f"this mass in the {solid.words}"
            )
        else:
            scale, scale_is = 1.0, "relative"
            note = (
                "inertia: relative, the middle moment is 1: the run does not determine its scale, a mass "
                f"alone does not set it, and no volume does ({no_solid}); give it by --middle-moment-kg-m2"
            )
        # the scale of the moments as stored: the middle one is 1
        moments = scale * np.array(found.moments)
        R_GP, (com_G, moved_m) = np.array(summary.R_GP), possible_com(summary)
        notes.append(note)
        if moved_m > 0.0:
            notes.append(
                f"centre of mass: moved by {1e3 * moved_m:.3g} mm into the body, as nothing determines it"
            )
        if mass_is == "relative" and scale_is == "relative":
            notes.append(
                "free motion is right at any scale; reactions to forces, torques and contacts are not"
            )
        names = {"k1": "k1", "k2": "k2", "axes": "the principal axes", "com": "the centre of mass"}
        known = summary.identifiable
        lost = [words for name, words in names.items() if known is not None and not getattr(known, name)]
        if lost:
            notes.append(
                f"not determined by the motion: {', '.join(lost)}; the numbers here are the best finite "
                "ones, which repeat the motion that was seen"
            )
            if ranges := describe_intervals(summary):
                notes.append(f"possible by the hull of the body: {'; '.join(ranges)}")
    return Inertial(
        mass_kg=mass,
        com_F=transform_points(X_FG, com_G[None])[0],
        R_FP=X_FG[:3, :3] @ R_GP,
        moments_kg_m2=moments,
        mass_is=mass_is,
        scale_is=scale_is,
        notes=tuple(notes),
        restated=tuple(restated),
    )


def contradictions(inertial: Inertial, solid: Solid | None, vertices_F: Array) -> list[str]:
    """A warning for what was given and does not fit the mesh (V, 3).

    Mass within the surface has a radius of gyration, the root of moment over mass, between 0 and the distance
    from the centre of mass to the farthest vertex (a uniform ball: 0.63 of it); and a density between those
    of air and gold. Raises InputError when the radius is off by more than any hidden part explains.
    """
    found, mass = [], inertial.mass_kg
    origins = (inertial.mass_is, inertial.scale_is)
    if "given" in origins and set(origins) <= {"given", "determined"}:
        moment = float(inertial.moments_kg_m2.max())
        radius = float(np.sqrt(moment / mass))
        farthest = float(np.linalg.norm(vertices_F - inertial.com_F, axis=1).max())
        reason = (
            f"a mass of {mass:g} kg with a largest moment of {moment:.3g} kg m^2 has a radius of gyration of "
            f"{radius:.3g} m, and the mesh reaches {farthest:.3g} m from the centre of mass: check --mass-kg "
            "[kg] and --middle-moment-kg-m2 [kg m^2]"
        )
        if not 0.005 * farthest <= radius <= 10.0 * farthest:
            raise InputError(reason)
        if not 0.05 * farthest <= radius <= farthest:
            found.append(reason)
    if inertial.mass_is == "given" and solid is not None:
        density = mass / solid.volume_m3
        if not 1.0 <= density <= 20_000.0:
            bound = "less than that of air" if density < 1.0 else "more than that of gold"
            found.append(
                f"a density of {density:.3g} kg/m^3, {bound}: {mass:g} kg in {solid.volume_m3:.3g} m^3, the "
                f"{solid.words}; check --mass-kg [kg] and the units of the calibration"
            )
    return found
