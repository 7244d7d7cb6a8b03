"""Light on surfaces: Sun, Earth, lamp; a diffuse and a GGX term, two-sided.

Levels are relative to a white diffuse surface that faces the Sun. GGX: Walter et al., "Microfacet
models for refraction through rough surfaces", EGSR 2007; joint Smith shadowing; Schlick's Fresnel.
"""

import numpy as np

from polhode.lie import Array
from polhode.records import Bools
from simulation.light import Lights
from simulation.materials import Surface
from simulation.raycast import Hits, RayCaster


def shade(hits: Hits, surface: Surface, to_viewer_G: Array, lights: Lights, caster: RayCaster) -> Array:
    """Level (n,) of light that leaves the hits towards the viewer, to_viewer_G (n, 3) unit."""
    level = _fill(surface, to_viewer_G, lights)
    if lights.sun > 0:
        visible = caster.lit(hits, lights.sun_direction_G)
        toward = np.broadcast_to(lights.sun_direction_G, hits.p_G.shape)
        level[visible] += lights.sun * _reflected(surface, toward, to_viewer_G, visible)
    if lights.lamp > 0:
        offset = lights.lamp_G - hits.p_G
        reach = np.linalg.norm(offset, axis=1)
        toward = offset / reach[:, None]
        visible = caster.lit(hits, toward, reach)
        level[visible] += (
            lights.lamp / reach[visible] ** 2 * _reflected(surface, toward, to_viewer_G, visible)
        )
    return level


def _fill(surface: Surface, to_viewer_G: Array, lights: Lights) -> Array:
    """The Earth's broad disc: soft on the diffuse part, mirrored by the clear part."""
    n = surface.normal_G
    from_earth = 0.5 * (1.0 + n @ lights.earth_direction_G)
    mirrored = 2.0 * np.einsum("nk,nk->n", n, to_viewer_G)[:, None] * n - to_viewer_G
    seen = np.clip((mirrored @ lights.earth_direction_G - 0.2) / 0.5, 0.0, 1.0)
    return np.asarray(lights.earth * (surface.albedo * from_earth**2 + 1.5 * surface.specular * seen))


def _reflected(surface: Surface, toward_G: Array, to_viewer_G: Array, where: Bools) -> Array:
    """Diffuse and specular reflection of unit light at the points ``where`` (n,) bool."""
    n, light, view = surface.normal_G[where], toward_G[where], to_viewer_G[where]
    n_l = np.clip(np.einsum("nk,nk->n", n, light), 0.0, 1.0)
    n_v = np.clip(np.einsum("nk,nk->n", n, view), 1e-3, 1.0)
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    n_h = np.clip(np.einsum("nk,nk->n", n, half), 0.0, 1.0)
    v_h = np.clip(np.einsum("nk,nk->n", view, half), 0.0, 1.0)
    alpha2 = surface.roughness[where] ** 4
    f0 = surface.specular[where]
    fresnel = f0 + (1.0 - f0) * (1.0 - v_h) ** 5
    density = alpha2 / (np.pi * (n_h**2 * (alpha2 - 1.0) + 1.0) ** 2)
    smith = n_l * np.sqrt(n_v**2 * (1 - alpha2) + alpha2) + n_v * np.sqrt(n_l**2 * (1 - alpha2) + alpha2)
    specular = np.pi * density * fresnel * 0.5 / np.maximum(smith, 1e-6)
    # Without a clear coat (f0 = 0, regolith) there is no mirror term at grazing angles either.
    specular = np.where(f0 > 0, specular, 0.0)
    return np.asarray(n_l * (surface.albedo[where] * (1.0 - f0) + specular))
