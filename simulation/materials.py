"""Surface materials and what they make of a point: reflectance, roughness, a bumped normal."""

from dataclasses import dataclass, fields

import numpy as np

from polhode.lie import Array
from polhode.records import Ints
from simulation.noise import cells, fractal, fractal_gradient


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
    """Slope of the relief that bends the normals."""
    bump_m: float = 0.01
    """Size of the relief's largest feature."""


PAINT_WHITE = Material(0.72, 0.04, 0.45, grain=0.04, grain_m=0.03)
PAINT_GREY = Material(0.38, 0.04, 0.5, grain=0.06, grain_m=0.03)
PAINT_DARK = Material(0.12, 0.04, 0.4, grain=0.08, grain_m=0.02)
PLASTIC = Material(0.30, 0.045, 0.35, grain=0.05, grain_m=0.04)
BARE_METAL = Material(0.16, 0.55, 0.42, grain=0.1, grain_m=0.015, bump=0.03, bump_m=0.004)
FOIL = Material(0.22, 0.5, 0.48, grain=0.15, grain_m=0.03, bump=0.22, bump_m=0.035)
SOLAR_CELL = Material(0.07, 0.06, 0.25, grain=0.1, grain_m=0.01)
REGOLITH = Material(0.34, 0.0, 1.0, grain=0.45, grain_m=0.05, bump=0.25, bump_m=0.012)
WORN_PANEL = Material(0.45, 0.05, 0.45, grain=0.15, grain_m=0.02, patch=0.45, patch_m=0.018)


@dataclass(frozen=True)
class Surface:
    """What the light meets at n points."""

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

    def __init__(self, materials: tuple[Material, ...], seed: int, contrast: float = 1.0) -> None:
        self._columns = {f.name: np.array([getattr(m, f.name) for m in materials]) for f in fields(Material)}
        # Each material draws from its own noise, so that two of them never share a pattern.
        self._seeds = np.arange(len(materials), dtype=np.int64) * 101 + seed % 1_000_003
        self._contrast = contrast

    def evaluate(
        self, material: Ints, p_G: Array, normal_G: Array, drawn_albedo: Array | None = None
    ) -> Surface:
        """Material index (n,), points and normals (n, 3) -> Surface.

        drawn_albedo (n,) replaces the material's mean reflectance where it is not NaN (stickers).
        """
        column = {name: values[material] for name, values in self._columns.items()}
        seed = self._seeds[material]
        mean = column["albedo"]
        variation = column["grain"] * fractal(p_G, column["grain_m"], seed)
        patched = column["patch"] > 0
        if patched.any():
            variation[patched] += column["patch"][patched] * cells(
                p_G[patched], column["patch_m"][patched], seed[patched] + 11
            )
        if drawn_albedo is not None:
            drawn = np.isfinite(drawn_albedo)
            blended = mean[drawn] + self._contrast * (drawn_albedo[drawn] - mean[drawn])
            mean = mean.copy()
            mean[drawn] = blended
        albedo = np.clip(mean * (1.0 + self._contrast * variation), 0.01, 0.95)
        normal = self._bumped(column, p_G, normal_G, seed)
        return Surface(albedo, column["specular"], column["roughness"], normal)

    @staticmethod
    def _bumped(column: dict[str, Array], p_G: Array, normal_G: Array, seed: Ints) -> Array:
        bumped = column["bump"] > 0
        if not bumped.any():
            return normal_G
        normal = normal_G.copy()
        gradient = fractal_gradient(p_G[bumped], column["bump_m"][bumped], seed[bumped] + 23)
        bent = normal_G[bumped] - column["bump"][bumped, None] * gradient
        normal[bumped] = bent / np.linalg.norm(bent, axis=1, keepdims=True)
        return normal
