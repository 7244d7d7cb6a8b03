"""Mass properties at uniform density (thesis 3.3): assumed where the motion leaves gaps, else compared.

The user gives the mass or a density. The volume and the uniform inertia are those of the mesh, or of its
convex hull where the mesh is open. The inertia that the motion determines up to scale is scaled by them.
"""

from typing import Any

import numpy as np
import trimesh

from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Bools, log_so3
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.mapping.finishing.hole_closing import boundary_loops
from polhode.mapping.uniform_solid import Solid, principal_axes, solid_body, solid_of
from polhode.mapping.visibility import Caster
from polhode.pipeline.coverage import describe_direction
from polhode.records.estimate import MassProperties
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Assumed, Physics

CLEAR_SIGMAS = 3.0
"""A difference is significant above this number of standard deviations."""
MIN_LOG_RATIO = 0.03
"""Logarithm of the ratio of two moments of the mesh below which their axes are not distinguishable."""
MESH_SHARE, MESH_DEG, MESH_K = 0.005, 2.0, 0.02
"""How well a closed mesh determines its centre of volume (share of its size), axes and inertia ratios."""


def assumed_properties(
    mass: MassProperties, surface: SurfaceModel, config: Backend
) -> tuple[Assumed | None, list[str]]:
    """The assumed part of the summary, and warnings; (None, []) when neither mass nor density is given."""
    kilograms, density = config.mass_kg, config.density_kg_m3
    if kilograms is None and density is None:
        return None, []
    solid, reason = solid_of(surface.mesh)
    if solid is None:
        return None, [f"nothing is assumed from the given mass or density: {reason}"]
    if kilograms is not None:
        density = kilograms / solid.volume_m3
        source = f"mass {kilograms:.6g} kg as given (backend.mass_kg)"
    else:
        assert density is not None
        kilograms = density * solid.volume_m3
        source = f"mass {kilograms:.4g} kg: density {density:.6g} kg/m^3 as given (backend.density_kg_m3)"
    known, uniform = mass.identifiable, density * solid.inertia
    inertia, of_inertia = uniform, "uniform density, as the motion does not determine all ratios and axes"
    if known.k1 and known.k2 and known.axes:
        # the same trace: the sum of the mean square distances does not depend on the axes
        inertia = np.trace(uniform) / np.trace(mass.J_G) * mass.J_G
        of_inertia = "ratios and axes as the motion determines them, scaled to the trace of uniform density"
    words = [solid.words, source, f"inertia: {of_inertia}"]
    for name in ("k1", "k2", "axes", "com"):
        if not getattr(known, name):
            words.append(f"{name}: uniform density, as the motion does not determine it")
    moments, R_GP = principal_axes(uniform)
    # the estimate, its undetermined components along the principal axes taken from the solid
    lost = mass.R_GP[:, ~known.com_P]
    found = {
        "words": words,
        "volume_m3": solid.volume_m3,
        "density_kg_m3": density,
        "mass_kg": kilograms,
        "inertia_kg_m2": inertia,
        "com_G": None if known.com else mass.com_G + lost @ (lost.T @ (solid.com_G - mass.com_G)),
        "k1": None if known.k1 else float(np.log(moments[0] / moments[1])),
        "k2": None if known.k2 else float(np.log(moments[1] / moments[2])),
        "R_GP": None if known.axes else R_GP,
    }
    return Assumed.model_validate(found), []


def check_physics(
    mass: MassProperties, surface: SurfaceModel, caster: Caster | None = None
) -> Physics | None:
    """Compare; None where the surface has no volume. ``caster``: of its mesh, if there is one already."""
    mesh, known = surface.mesh, mass.identifiable
    solid, _ = solid_of(mesh, caster)
    if solid is None:
        return None
    R_GP, k = principal_axes(solid.inertia)[1], _ratios(solid)
    other = solid if mesh.is_volume else _close_openings(mesh)
    words = [f"compared with uniform density in the {solid.words}"]
    found: dict[str, Any] = dict.fromkeys(
        ("com_offset_G", "com_offset_sigma_m", "axes_angle_deg", "axes_angle_sigma_deg")
    )
    found |= {"k1_difference": None, "k2_difference": None}
    # the volume of an open mesh is unknown if, its openings closed flat, it is a smaller share of its hull
    if other.volume_m3 <= 0.3 * solid.volume_m3:
        words.append("the hull is too far from the open mesh to compare the motion's mass properties with it")
    else:
        if known.com_P.any():
            # estimate minus uniform, what the motion does not determine left out
            axes_G = mass.R_GP[:, known.com_P]
            offset_G = axes_G @ (axes_G.T @ (mass.com_G - solid.com_G))
            # with one component undetermined no axis of G may have a finite variance: of those of P
            sigma_m = _sigma_along(mass.cov_com_G, offset_G)
            if not np.isfinite(mass.cov_com_G).all():
                of_P = np.diag(known.sigma[:3][known.com_P] ** 2)
                sigma_m = _sigma_along(of_P, mass.R_GP.T[known.com_P] @ offset_G)
            apart_m = float(np.linalg.norm(solid.com_G - other.com_G))
            volume_m = max(MESH_SHARE * float(np.linalg.norm(mesh.extents)), apart_m)
            words.append(_com_words(mass, offset_G, sigma_m, volume_m, bool(mesh.is_volume)))
            found |= {"com_offset_G": offset_G, "com_offset_sigma_m": sigma_m}
        distinct = np.array([k[1] > MIN_LOG_RATIO, k[0] + k[1] > MIN_LOG_RATIO, k[0] > MIN_LOG_RATIO])
        about = known.axes_P & distinct
        if (axes := _between(mass.R_GP, R_GP, about)) is not None:
            name, angle_rad, about_P = axes
            sigma_deg = float(np.rad2deg(_sigma_along(mass.cov_R_GP, about_P)))
            closing = _between(R_GP, principal_axes(other.inertia)[1], about)
            volume_deg = max(MESH_DEG, float(np.rad2deg(closing[1])) if closing is not None else np.inf)
            words += _axes_words(name, float(np.rad2deg(angle_rad)), sigma_deg, volume_deg)
            found |= {"axes_angle_deg": np.rad2deg(angle_rad), "axes_angle_sigma_deg": sigma_deg}
        volume_k = max(MESH_K, float(np.abs(np.subtract(k, _ratios(other))).max()))
        for n, name in enumerate(("k1", "k2")):
            if getattr(known, name):
                found[f"{name}_difference"] = difference = getattr(mass, name) - k[n]
                sigma = float(np.sqrt(mass.cov_k[n, n]))
                least = max(CLEAR_SIGMAS * sigma, volume_k)
                text = f"{name} agrees with the volume's {k[n]:.3f} within {least:.2g}"
                if abs(difference) > least:
                    larger = "larger" if difference > 0.0 else "smaller"
                    text = (
                        f"{name} is {abs(difference):.3f} {larger} than the volume's {k[n]:.3f} (sigma "
                        f"{sigma:.2g}; the volume's known to about {volume_k:.2g})"
                    )
                words.append(text)
    uniform = {"com_uniform_G": solid.com_G, "R_GP_uniform": R_GP, "k1_uniform": k[0], "k2_uniform": k[1]}
    return Physics.model_validate({"words": words, "volume_m3": solid.volume_m3, **uniform, **found})


def _close_openings(mesh: trimesh.Trimesh) -> Solid:
    """The mesh with every opening closed by a fan from its middle: another estimate of the volume."""
    vertices, faces = [np.asarray(mesh.vertices)], [np.asarray(mesh.faces)]
    for count, loop in enumerate(boundary_loops(faces[0]), start=len(mesh.vertices)):
        vertices.append(vertices[0][loop].mean(axis=0, keepdims=True))
        faces.append(np.column_stack([loop, np.roll(loop, -1), np.full(len(loop), count)]))
    return solid_body(trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False), "")


def _ratios(solid: Solid) -> tuple[float, float]:
    moments, _ = principal_axes(solid.inertia)
    moments = np.maximum(moments, 1e-12 * max(float(moments[0]), 1e-300))
    return float(np.log(moments[0] / moments[1])), float(np.log(moments[1] / moments[2]))


def _sigma_along(covariance: Array, direction: Array) -> float:
    """Along a direction (n,), without what is undetermined."""
    unit = direction / max(float(np.linalg.norm(direction)), 1e-300)
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    return float(np.sqrt(max(float(unit @ finite @ unit), 0.0)))


def _between(R_GP: Array, R_GP_other: Array, about: Bools) -> tuple[str, float, Array] | None:
    """The smallest rotation between axes: what is compared, angle [rad], unit vector (3,) in P.

    ``about`` (3,): the axes about which both determine it. None: these are too few.
    """
    if about.all():
        found = np.array([log_so3(R_GP.T @ (R_GP_other * half_turn)) for half_turn in HALF_TURNS])
        angles = np.linalg.norm(found, axis=1)
        best = int(np.argmin(angles))
        return "axes", float(angles[best]), found[best] / max(float(angles[best]), 1e-300)
    for axis in range(3):
        if np.delete(about, axis).all():
            across = R_GP.T @ np.cross(R_GP[:, axis], R_GP_other[:, axis])
            length = float(np.linalg.norm(across))
            return f"axis {'xyz'[axis]}", float(np.arcsin(min(length, 1.0))), across / max(length, 1e-300)
    return None


def _com_words(mass: MassProperties, offset_G: Array, sigma_m: float, volume_m: float, closed: bool) -> str:
    def mm(metres: float) -> str:
        return f"{1e3 * metres:.2g} mm" if metres < 0.1 else f"{1e3 * metres:.0f} mm"

    length, least = float(np.linalg.norm(offset_G)), max(CLEAR_SIGMAS * sigma_m, volume_m)
    lost = [axis for axis, flag in zip("xyz", mass.identifiable.com_P, strict=True) if not flag]
    undetermined = f"; along {' and '.join(lost)} of P is not determined by the motion" if lost else ""
    if length <= least:
        return f"the centre of mass agrees with the volume's centre within {mm(least)}{undetermined}"
    return (
        f"the centre of mass is {mm(length)} off the volume's centre along {describe_direction(offset_G)} of "
        f"G (sigma {mm(sigma_m)}; the volume's centre is known to about {mm(volume_m)}): mass is not spread "
        f"evenly{'' if closed else ', or the hull is not the body'}{undetermined}"
    )


def _axes_words(name: str, angle_deg: float, sigma_deg: float, volume_deg: float) -> list[str]:
    many, least = name == "axes", max(CLEAR_SIGMAS * sigma_deg, volume_deg)
    if least > 20.0:
        return []
    if angle_deg <= least:
        verb = "agree" if many else "agrees"
        return [f"the principal {name} {verb} with the volume's within {least:.2g} deg"]
    return [
        f"the principal {name} {'are' if many else 'is'} rotated by {angle_deg:.3g} deg from the volume's "
        f"(sigma {sigma_deg:.2g} deg; the volume's known to about {volume_deg:.2g} deg)"
    ]
