"""Mass and inertia for simulators: what the run knows, what the user gave, what had to be assumed.

A motion without known torques determines the inertia up to scale only, and a mass does not set that scale: it
takes a length as well. In order: the middle moment as given; known torques; uniform density in the volume
of the mesh, at the mass as given or found; else the numbers are relative, and the files say so.
"""

import numpy as np

from polhode.lie import transform_points
from polhode.mapping.uniform_solid import Solid, principal_axes
from polhode.pipeline.run_directory.summary_schema import Summary
from polhode.planning.exports.records import Inertial, Placement

UNIT_MASS_KG = 1.0


def inertial_of(
    summary: Summary,
    solid: Solid | None,
    why_no_solid: str,
    at: Placement,
    mass_kg: float | None,
    middle_kg_m2: float | None,
) -> Inertial | None:
    """In F; None when there is neither an estimate nor a volume. ``solid``: the mesh at density 1."""
    mass, mass_is, words = _mass(summary, mass_kg)
    if summary.inertia is None or summary.R_GP is None or summary.com_G is None:
        return None if solid is None else _uniform(solid, at, mass, mass_is, words)
    # the scale of the moments as stored: the middle one is 1
    moments = np.array(summary.inertia.moments)
    known = summary.inertia
    if middle_kg_m2 is not None:
        scale, scale_is = middle_kg_m2, "given"
        words.append(f"inertia: scaled to the middle moment as given, {scale:g} kg m^2")
    elif known.scale_kg_m2 is not None and known.sigma_scale_kg_m2 is not None:
        scale, scale_is = known.scale_kg_m2, "determined"
        words.append(
            f"inertia: scale determined by the known torques, middle moment {scale:.6g} kg m^2 "
            f"(standard deviation {known.sigma_scale_kg_m2:.2g})"
        )
    elif solid is not None:
        # the same trace: the sum of the mean square distances does not depend on the axes
        scale = mass / solid.volume_m3 * float(np.trace(solid.inertia)) / float(moments.sum())
        scale_is = "relative" if mass_is == "relative" else "assumed"
        words.append(
            "inertia: ratios and axes by the motion; their scale is assumed, that of uniform density at this "
            f"mass in the {solid.words}"
        )
    else:
        scale, scale_is = 1.0, "relative"
        words.append(
            "inertia: relative, the middle moment is 1: the run does not determine its scale, a mass alone "
            f"does not set it, and no volume does ({why_no_solid}); give it by --middle-moment-kg-m2"
        )
    if mass_is == "relative" and scale_is == "relative":
        words.append("free motion is right at any scale; reactions to forces, torques and contacts are not")
    words += _undetermined(summary)
    return Inertial(
        mass_kg=mass,
        com_F=transform_points(at.X_FG, np.array([summary.com_G]))[0],
        R_FP=at.R_FG @ np.array(summary.R_GP),
        moments_kg_m2=scale * moments,
        mass_is=mass_is,
        scale_is=scale_is,
        words=tuple(words),
    )


def _mass(summary: Summary, given: float | None) -> tuple[float, str, list[str]]:
    if given is not None:
        return given, "given", [f"mass: {given:g} kg as given"]
    found = summary.inertia
    if found is not None and found.mass_kg is not None and found.sigma_mass_kg is not None:
        words = f"mass: {found.mass_kg:.6g} kg from the known forces"
        return found.mass_kg, "determined", [f"{words} (standard deviation {found.sigma_mass_kg:.2g})"]
    if summary.assumed is not None:
        mass = summary.assumed.mass_kg
        return mass, "assumed", [f"mass: {mass:.6g} kg, from the mass or density that the run was given"]
    words = "mass: relative, set to 1: the run does not determine it; give it by --mass-kg"
    return UNIT_MASS_KG, "relative", [words]


def _undetermined(summary: Summary) -> list[str]:
    """What the motion leaves open: the numbers are the best finite ones, which repeat the motion seen."""
    known = summary.identifiable
    if known is None:
        return []
    names = {
        "k1": known.k1,
        "k2": known.k2,
        "the principal axes": known.axes,
        "the centre of mass": known.com,
    }
    lost = [name for name, determined in names.items() if not determined]
    if not lost:
        return []
    return [
        f"not determined by the motion: {', '.join(lost)}; the numbers here are the best finite ones, which "
        "repeat the motion that was seen"
    ]


def _uniform(solid: Solid, at: Placement, mass: float, mass_is: str, words: list[str]) -> Inertial:
    moments, R_GP = principal_axes(mass / solid.volume_m3 * solid.inertia)
    return Inertial(
        mass_kg=mass,
        com_F=transform_points(at.X_FG, solid.com_G[None])[0],
        R_FP=at.R_FG @ R_GP,
        moments_kg_m2=moments,
        mass_is=mass_is,
        scale_is="relative" if mass_is == "relative" else "assumed",
        words=(
            *words,
            f"inertia and centre of mass: assumed, uniform density in the {solid.words}, as the run has no "
            "estimate of them",
        ),
    )
