"""Mass properties at uniform density (thesis 3.3): assumed where the motion leaves gaps, else compared.

The user gives the mass or a density. The volume and the uniform inertia are those of the mesh, or of its
convex hull where the mesh is open. The inertia that the motion determines up to scale is scaled by them.
"""

from typing import NamedTuple

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
MIN_LIDDED_SHARE = 0.3
"""The volume of an open mesh is unknown if, its openings closed flat, it is a smaller share of its hull."""


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
    inertia, words = uniform, [solid.words, source]
    if known.k1 and known.k2 and known.axes:
        # the same trace: the sum of the mean square distances does not depend on the axes
        inertia = np.trace(uniform) / np.trace(mass.J_G) * mass.J_G
        words.append(
            "inertia: ratios and axes as the motion determines them, scaled to the trace of uniform density"
        )
    else:
        words.append("inertia: uniform density, as the motion does not determine all ratios and axes")
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


class _Axes(NamedTuple):
    """The principal axes that can be compared, and the angle between them."""

    words: str
    angle_rad: float
    about_P: Array
    """(3,) unit vector"""


def check_physics(
    mass: MassProperties, surface: SurfaceModel, caster: Caster | None = None
) -> Physics | None:
    """Compare; None where the surface has no volume. ``caster``: of its mesh, if there is one already."""
    mesh, known = surface.mesh, mass.identifiable
    solid, _ = solid_of(mesh, caster)
    if solid is None:
        return None
    _, R_GP = principal_axes(solid.inertia)
    k = _ratios(solid)
    other = solid if mesh.is_volume else _close_openings(mesh)
    words = [f"compared with uniform density in the {solid.words}"]
    offset_G = com_sigma_m = angle_deg = axes_sigma_deg = None
    differences: list[float | None] = [None, None]
    if other.volume_m3 <= MIN_LIDDED_SHARE * solid.volume_m3:
        words.append("the hull is too far from the open mesh to compare the motion's mass properties with it")
    else:
        if known.com_P.any():
            # estimate minus uniform, what the motion does not determine left out
            axes_G = mass.R_GP[:, known.com_P]
            offset_G = axes_G @ (axes_G.T @ (mass.com_G - solid.com_G))
            com_sigma_m = _com_sigma_m(mass, offset_G)
            size_m = float(np.linalg.norm(mesh.extents))
            volume_m = max(MESH_SHARE * size_m, float(np.linalg.norm(solid.com_G - other.com_G)))
            words.append(_com_words(mass, offset_G, com_sigma_m, volume_m, bool(mesh.is_volume)))
        distinct = np.array([k[1] > MIN_LOG_RATIO, k[0] + k[1] > MIN_LOG_RATIO, k[0] > MIN_LOG_RATIO])
        about = known.axes_P & distinct
        if (axes := _between(mass.R_GP, R_GP, about)) is not None:
            angle_deg = np.rad2deg(axes.angle_rad)
            axes_sigma_deg = np.rad2deg(_sigma_along(mass.cov_R_GP, axes.about_P))
            closing = _between(R_GP, principal_axes(other.inertia)[1], about)
            volume_deg = max(
                MESH_DEG, float(np.rad2deg(closing.angle_rad)) if closing is not None else np.inf
            )
            words += _axes_words(axes, axes_sigma_deg, volume_deg)
        volume_k = max(MESH_K, float(np.abs(np.subtract(k, _ratios(other))).max()))
        for n, name in enumerate(("k1", "k2")):
            if getattr(known, name):
                differences[n] = difference = getattr(mass, name) - k[n]
                sigma = float(np.sqrt(mass.cov_k[n, n]))
                words.append(_ratio_words(name, difference, k[n], sigma, volume_k))
    return Physics.model_validate(
        {
            "words": words,
            "volume_m3": solid.volume_m3,
            "com_uniform_G": solid.com_G,
            "com_offset_G": offset_G,
            "com_offset_sigma_m": com_sigma_m,
            "R_GP_uniform": R_GP,
            "axes_angle_deg": angle_deg,
            "axes_angle_sigma_deg": axes_sigma_deg,
            "k1_uniform": k[0],
            "k2_uniform": k[1],
            "k1_difference": differences[0],
            "k2_difference": differences[1],
        }
    )


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


def _com_sigma_m(mass: MassProperties, offset_G: Array) -> float:
    """Of the estimate along the offset. With one component undetermined no axis of G may have a finite
    variance, so it is computed from those of P."""
    if np.isfinite(mass.cov_com_G).all():
        return _sigma_along(mass.cov_com_G, offset_G)
    known = mass.identifiable.com_P
    return _sigma_along(np.diag(mass.identifiable.sigma[:3][known] ** 2), mass.R_GP.T[known] @ offset_G)


def _sigma_along(covariance: Array, direction: Array) -> float:
    """Along a direction (n,), without what is undetermined."""
    unit = direction / max(float(np.linalg.norm(direction)), 1e-300)
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    return float(np.sqrt(max(float(unit @ finite @ unit), 0.0)))


def _between(R_GP: Array, R_GP_other: Array, about: Bools) -> _Axes | None:
    """The smallest rotation between axes; ``about`` (3,): the axes about which both determine it.

    None: these are too few.
    """
    if about.all():
        found = np.array([log_so3(R_GP.T @ (R_GP_other * half_turn)) for half_turn in HALF_TURNS])
        angles = np.linalg.norm(found, axis=1)
        best = int(np.argmin(angles))
        return _Axes("axes", float(angles[best]), found[best] / max(float(angles[best]), 1e-300))
    for axis in range(3):
        if np.delete(about, axis).all():
            across = R_GP.T @ np.cross(R_GP[:, axis], R_GP_other[:, axis])
            angle = float(np.arcsin(min(float(np.linalg.norm(across)), 1.0)))
            return _Axes(f"axis {'xyz'[axis]}", angle, across / max(float(np.linalg.norm(across)), 1e-300))
    return None


def _com_words(mass: MassProperties, offset_G: Array, sigma_m: float, volume_m: float, closed: bool) -> str:
    length, least = float(np.linalg.norm(offset_G)), max(CLEAR_SIGMAS * sigma_m, volume_m)
    lost = [axis for axis, flag in zip("xyz", mass.identifiable.com_P, strict=True) if not flag]
    undetermined = f"; along {' and '.join(lost)} of P is not determined by the motion" if lost else ""
    if length <= least:
        return f"the centre of mass agrees with the volume's centre within {_mm(least)}{undetermined}"
    return (
        f"the centre of mass is {_mm(length)} off the volume's centre "
        f"along {describe_direction(offset_G)} of G "
        f"(sigma {_mm(sigma_m)}; the volume's centre is known to about {_mm(volume_m)}): "
        f"mass is not spread evenly{'' if closed else ', or the hull is not the body'}{undetermined}"
    )


def _axes_words(axes: _Axes, sigma_deg: float, volume_deg: float) -> list[str]:
    angle_deg, many = np.rad2deg(axes.angle_rad), axes.words == "axes"
    least = max(CLEAR_SIGMAS * sigma_deg, volume_deg)
    if least > 20.0:
        return []
    if angle_deg <= least:
        verb = "agree" if many else "agrees"
        return [f"the principal {axes.words} {verb} with the volume's within {least:.2g} deg"]
    return [
        f"the principal {axes.words} {'are' if many else 'is'} rotated by {angle_deg:.3g} deg from the "
        f"volume's (sigma {sigma_deg:.2g} deg; the volume's known to about {volume_deg:.2g} deg)"
    ]


def _ratio_words(name: str, difference: float, uniform: float, sigma: float, volume_k: float) -> str:
    least = max(CLEAR_SIGMAS * sigma, volume_k)
    if abs(difference) <= least:
        return f"{name} agrees with the volume's {uniform:.3f} within {least:.2g}"
    return (
        f"{name} is {abs(difference):.3f} {'larger' if difference > 0.0 else 'smaller'} than the volume's "
        f"{uniform:.3f} (sigma {sigma:.2g}; the volume's known to about {volume_k:.2g})"
    )


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.2g} mm" if metres < 0.1 else f"{1e3 * metres:.0f} mm"
