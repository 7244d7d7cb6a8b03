"""Surface materials, and their evaluation at points: reflectance, roughness, perturbed normal.

Paint, foil and cells follow the solar absorptances of spacecraft materials in Gilmore, "Spacecraft Thermal
Control Handbook", 2002, appendix A (absorptance + reflectance = 1; white silicate paint 0.15-0.2, black Z306
0.95, aluminised Kapton 0.35-0.4, aluminium foil 0.1-0.15, cells under glass 0.85-0.92). The metals have
their Fresnel reflectance at normal incidence, less the loss by oxide and dirt. The diffuse reflectance is
``albedo * (1 - specular)``. Lengths of the textures are those of a body of 0.3 m and scale with it.
"""

from dataclasses import dataclass, fields

import numpy as np

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled
from polhode.simulation.surface.noise import cell_at, creases_at, fractal_at
from polhode.simulation.surface.spot_noise import SPOT_SLOPE, discs_at, folds_at, layered_spots_at

ALBEDO, SPECULAR, ROUGHNESS, GRAIN, GRAIN_M, PATCH, PATCH_M, BUMP, BUMP_M, CREASE, CREASE_M, STREAK = range(
    12
)
"""Columns of the table that compiled loops read: the material's fields in their order."""


@dataclass(frozen=True)
class Material:
    """A surface. Variations are relative to ``albedo``; lengths [m]."""

    albedo: float
    """Mean diffuse reflectance."""
    specular: float = 0.04
    """Reflectance of the clear surface at normal incidence (F0)."""
    roughness: float = 0.5
    """GGX roughness, alpha = roughness^2."""
    grain: float = 0.0
    """Amplitude of the fractal variation."""
    grain_m: float = 0.02
    """Its largest feature."""
    patch: float = 0.0
    """Amplitude of the sharp-edged patches."""
    patch_m: float = 0.02
    """Their size."""
    bump: float = 0.0
    """Slope of the relief that perturbs the normals."""
    bump_m: float = 0.01
    """Size of the relief's largest feature."""
    crease: float = 0.0
    """Greatest tilt of the flat pieces of crumpled foil."""
    crease_m: float = 0.03
    """Size of the largest of them."""
    streak: float = 1.0
    """How much longer the variation is along z of G than across: brushed and drawn metal."""


PAINT_WHITE = Material(0.78, 0.04, 0.55, grain=0.05, grain_m=0.03)
PAINT_GREY = Material(0.36, 0.04, 0.5, grain=0.06, grain_m=0.03)
PAINT_BLACK = Material(0.05, 0.04, 0.5, grain=0.15, grain_m=0.02)
PLASTIC = Material(0.30, 0.045, 0.35, grain=0.05, grain_m=0.04)
BRUSHED_METAL = Material(0.08, 0.68, 0.42, grain=0.15, grain_m=0.008, bump=0.035, bump_m=0.004, streak=9.0)
ANODISED = Material(0.28, 0.22, 0.5, grain=0.07, grain_m=0.02)
DARK_METAL = Material(0.10, 0.30, 0.45, grain=0.2, grain_m=0.02, bump=0.02, bump_m=0.01)
COMPOSITE = Material(0.045, 0.05, 0.35, grain=0.2, grain_m=0.006)
GLASS = Material(0.015, 0.05, 0.15)
FOIL_GOLD = Material(0.14, 0.52, 0.34, grain=0.3, grain_m=0.03, crease=0.36, crease_m=0.034)
FOIL_SILVER = Material(0.25, 0.75, 0.34, grain=0.3, grain_m=0.03, crease=0.34, crease_m=0.034)
FOIL_BLACK = Material(0.05, 0.08, 0.34, grain=0.3, grain_m=0.03, crease=0.36, crease_m=0.034)
TAPE = Material(0.10, 0.60, 0.38, grain=0.1, grain_m=0.01, bump=0.05, bump_m=0.01)
VINYL = Material(0.5, 0.045, 0.42)
MIRROR = Material(0.03, 0.85, 0.14, bump=0.004, bump_m=0.03)
SOLAR_CELL = Material(0.035, 0.045, 0.16, grain=0.15, grain_m=0.02)
REGOLITH = Material(
    0.30, 0.0, 1.0, grain=0.2, grain_m=0.06, patch=0.13, patch_m=0.005, crease=0.2, crease_m=0.008
)
WORN_PANEL = Material(0.42, 0.05, 0.45, grain=0.15, grain_m=0.02, patch=0.45, patch_m=0.018)


@dataclass(frozen=True)
class Surface:
    """Properties of a surface at n points."""

    albedo: Array
    """(n,) diffuse reflectance"""
    specular: Array
    """(n,)"""
    roughness: Array
    """(n,)"""
    normal_G: Array
    """(n, 3) unit, bumped"""


class MaterialTable:
    """All materials of a body, one row each, evaluated at many points at once."""

    def __init__(
        self,
        materials: tuple[Material, ...],
        seed: int,
        contrast: float = 1.0,
        scale: float = 1.0,
        collage: bool = False,
    ) -> None:
        """``scale`` multiplies all lengths; ``collage`` selects the noise of the second generator."""
        rows = [[getattr(material, field.name) for field in fields(Material)] for material in materials]
        self._rows = np.array(rows, dtype=np.float64).reshape(-1, len(fields(Material)))
        # Each material has its own noise, so that no two share a pattern.
        self._seeds = np.arange(len(materials), dtype=np.int64) * 101 + seed % 1_000_003
        self._contrast = contrast
        self._scale = scale
        self._collage = collage

    def evaluate(
        self,
        material: Ints,
        p_G: Array,
        normal_G: Array,
        drawn_albedo: Array | None = None,
        slope_G: Array | None = None,
        ground: Ints | None = None,
    ) -> Surface:
        """Material index (n,), points and normals (n, 3) -> Surface.

        drawn_albedo (n,) replaces the material's mean reflectance where it is not NaN; slope_G
        (n, 3) is the gradient of a drawn relief; ``ground`` (n,) is the material whose mean reflectance shows
        where the contrast is below 1.
        """
        n = len(material)
        drawn = np.full(n, np.nan) if drawn_albedo is None else drawn_albedo
        slope = np.zeros((n, 3)) if slope_G is None else slope_G
        under = material if ground is None else ground
        p, normal = np.ascontiguousarray(p_G), np.ascontiguousarray(normal_G)
        found = _evaluate(
            material, under, p, normal, drawn, slope,
            self._rows, self._seeds, self._scale, self._contrast, self._collage,
        )  # fmt: skip
        return Surface(*found)


@compiled
def _evaluate(
    material: Ints,
    ground: Ints,
    p: Array,
    normal: Array,
    drawn: Array,
    slope: Array,
    rows: Array,
    seeds: Ints,
    scale: float,
    contrast: float,
    collage: bool,
) -> tuple[Array, Array, Array, Array]:
    count = len(material)
    albedo, specular, roughness = np.empty(count), np.empty(count), np.empty(count)
    bent = np.empty((count, 3))
    for n in range(count):
        m = material[n]
        specular[n], roughness[n] = rows[m, SPECULAR], rows[m, ROUGHNESS]
        mean = rows[ground[n], ALBEDO]
        if np.isfinite(drawn[n]):
            mean += contrast * (drawn[n] - mean)
        elif contrast > 0.0:
            mean += contrast * (rows[m, ALBEDO] - mean)
        # A chart replaces the patches, not the grain.
        patched = not np.isfinite(drawn[n])
        variation = _variation(rows[m], p[n], seeds[m], scale, collage, patched) if contrast > 0.0 else 0.0
        albedo[n] = min(max(mean * (1.0 + contrast * variation), 0.01), 0.95)
        tilt = _tilt(rows[m], p[n], seeds[m], scale, collage)
        length = 0.0
        for axis in range(3):
            bent[n, axis] = normal[n, axis] - slope[n, axis] - tilt[axis]
            length += bent[n, axis] * bent[n, axis]
        bent[n] /= np.sqrt(length)
    return albedo, specular, roughness, bent


@compiled
def _variation(row: Array, p: Array, seed: int, scale: float, collage: bool, patched: bool) -> float:
    """Relative variation of the reflectance at a point, by grain and patches."""
    variation = 0.0
    along = 1.0 / row[STREAK]
    if row[GRAIN] > 0.0:
        s = 1.0 / (scale * row[GRAIN_M])
        if collage:
            variation += row[GRAIN] * layered_spots_at(p[0] * s, p[1] * s, p[2] * s * along, seed)[0]
        else:
            variation += row[GRAIN] * fractal_at(p[0] * s, p[1] * s, p[2] * s * along, 4, seed)[0]
    if patched and row[PATCH] > 0.0:
        s = 1.0 / (scale * row[PATCH_M])
        if collage:
            variation += row[PATCH] * discs_at(0.5 * p[0] * s, 0.5 * p[1] * s, 0.5 * p[2] * s, seed + 11)
        else:
            variation += row[PATCH] * cell_at(p[0] * s, p[1] * s, p[2] * s, seed + 11)
    return variation


@compiled
def _tilt(row: Array, p: Array, seed: int, scale: float, collage: bool) -> tuple[float, float, float]:
    """Gradient of the relief at a point, by bumps and creases."""
    tx, ty, tz = 0.0, 0.0, 0.0
    along = 1.0 / row[STREAK]
    if row[BUMP] > 0.0:
        s = 1.0 / (scale * row[BUMP_M])
        if collage:
            _, gx, gy, gz = layered_spots_at(p[0] * s, p[1] * s, p[2] * s * along, seed + 23)
            gx, gy, gz = SPOT_SLOPE * gx, SPOT_SLOPE * gy, SPOT_SLOPE * gz
        else:
            _, gx, gy, gz = fractal_at(p[0] * s, p[1] * s, p[2] * s * along, 3, seed + 23)
        tx, ty, tz = row[BUMP] * gx, row[BUMP] * gy, row[BUMP] * gz * along
    if row[CREASE] > 0.0:
        s = 1.0 / (scale * row[CREASE_M])
        if collage:
            gx, gy, gz = folds_at(p[0] * s, p[1] * s, p[2] * s, seed + 41)
        else:
            gx, gy, gz = creases_at(p[0] * s, p[1] * s, p[2] * s, seed + 41)
        tx += row[CREASE] * gx
        ty += row[CREASE] * gy
        tz += row[CREASE] * gz
    return tx, ty, tz
