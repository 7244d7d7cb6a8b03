"""Light that leaves a surface: from Sun, Earth and lamp, and from other parts of the body.

Levels are relative to a white diffuse surface that faces the Sun. Rough surfaces take what they reflect
specularly from the views of the probes (indirect.py), which are free of noise. Sharp surfaces trace one ray
per hit; these rays are spread over the GGX lobe from sample to sample of a pixel, and shaded where they end.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from polhode.geometry.lie import Array, Bools
from polhode.simulation.rendering.appearance import SurfaceAppearance
from polhode.simulation.rendering.indirect import IndirectAtHits, IndirectLight
from polhode.simulation.rendering.light import Lights, disc_irradiance
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.reflection import (
    earth_share_of_lobe,
    lobe_rays,
    reflected,
    reflected_earth,
    specular_albedo,
)
from polhode.simulation.rendering.sampling import Stratum
from polhode.simulation.surface.materials import Surface

MIN_TRACED_SHARE, FULL_TRACED_SHARE = 0.06, 0.12
"""Specular albedo above which rays of a sharp surface are traced, and above which they replace the probes."""
SHARP_ALPHA = 0.07
"""GGX alpha below which a surface is sharp: this is about the resolution of the probes' views."""
MIN_TRACED_ROUGHNESS = 0.5
"""Minimum roughness of surfaces that a traced ray hits: one ray cannot average sharper highlights."""
LOBE_CORE = 0.92
"""Radius of the part of the lobe that is traced: rays in its tail that hit something bright make speckles."""
EARTH_EDGE = 0.5
"""Width of the Earth's edge for one ray, relative to the lobe that the rays of a pixel are spread over."""


@dataclass(frozen=True)
class IncidentLight:
    """Indirect light on n hits."""

    bounced: Array | float = 0.0
    """(n,) irradiance of light that other parts reflect"""
    earth_share: Array | float = 1.0
    """(n,) share of the Earth's light that no part blocks"""
    mirrored: Array | None = None
    """(n,) specular reflections of body and Earth; None: of the unoccluded part of the Earth alone"""


def shade(
    hits: Hits,
    surface: Surface,
    to_viewer_G: Array,
    lights: Lights,
    caster: RayCaster,
    to_sun_G: Array | None = None,
    incident: IncidentLight | None = None,
) -> Array:
    """Level (n,) of light that leaves the hits towards the viewer.

    to_viewer_G (n, 3) unit; to_sun_G (n, 3) unit, to the point of the Sun's disc that the shadow ray
    aims at, its centre if absent; incident: indirect light, none if absent.
    """
    incident = incident or IncidentLight()

    def direct(toward_G: Array, where: Bools) -> Array:
        """Diffuse and specular reflection of unit light at the hits ``where`` (n,)."""
        s, albedo = surface, surface.albedo[where]
        lobe = (s.specular[where], s.roughness[where] ** 4)
        return np.asarray(reflected(s.normal_G[where], toward_G[where], to_viewer_G[where], albedo, *lobe))

    # The Earth and other parts, diffuse and specular.
    cosine = surface.normal_G @ lights.earth_direction_G
    earth = lights.earth * incident.earth_share * disc_irradiance(cosine, lights.earth_radius_rad)
    level = surface.albedo * (1.0 - surface.specular) * (earth + incident.bounced)
    if incident.mirrored is not None:
        level = level + incident.mirrored
    else:
        share = specular_albedo(surface, to_viewer_G) * reflected_earth(surface, to_viewer_G, lights)
        level = level + lights.earth * incident.earth_share * share
    if lights.sun > 0:
        visible = caster.lit(hits, lights.sun_direction_G if to_sun_G is None else to_sun_G)
        toward = np.broadcast_to(lights.sun_direction_G, (len(level), 3))
        level[visible] += lights.sun * direct(toward, visible)
    if lights.lamp > 0:
        toward, reach = lights.lamp_from(hits.p_G)
        visible = caster.lit(hits, toward, reach)
        at_hit = lights.lamp / reach[visible] ** 2
        level[visible] += at_hit * direct(toward, visible)
    return np.asarray(level)


class SpecularTracer:
    """Specular reflections of the body and the Earth in the body's own surfaces."""

    def __init__(
        self, caster: RayCaster, appearance: SurfaceAppearance, indirect: IndirectLight, bounces: int
    ) -> None:
        self._caster, self._appearance, self._indirect, self._bounces = caster, appearance, indirect, bounces

    def level(
        self,
        hits: Hits,
        surface: Surface,
        to_viewer_G: Array,
        lights: Lights,
        around: IndirectAtHits,
        stratum: Stratum,
    ) -> Array:
        """Level (n,) of body and Earth that n hits reflect towards the viewer, to_viewer_G (n, 3) unit."""
        level = around.mirrored(surface, to_viewer_G, hits.flat_normal_G, stratum)
        share = specular_albedo(surface, to_viewer_G)
        sharp = np.flatnonzero((surface.roughness**2 < SHARP_ALPHA) & (share > MIN_TRACED_SHARE))
        if len(sharp) == 0:
            return level
        # One traced ray per hit of a sharp surface.
        s = Surface(*(getattr(surface, field.name)[sharp] for field in fields(surface)))
        hits, share = hits[sharp], share[sharp]
        alpha, place = np.maximum(s.roughness**2, 1e-3), LOBE_CORE * stratum[sharp].on_disc(use=1)
        rays, weight = lobe_rays(s.normal_G, to_viewer_G[sharp], alpha, s.specular, place, hits.flat_normal_G)
        met = self._caster.next_hits(hits, rays)
        seen = lights.earth * earth_share_of_lobe(rays, EARTH_EDGE * alpha, lights)
        seen[met.ray] = 0.0
        if self._bounces:
            # The hits of traced rays, under Sun, Earth and lamp.
            there = self._appearance.at(met)
            there = replace(there, roughness=np.maximum(there.roughness, MIN_TRACED_ROUGHNESS))
            incident = IncidentLight(earth_share=self._indirect.at(met, lights).earth_share())
            seen[met.ray] = shade(met, there, -rays[met.ray], lights, self._caster, incident=incident)
        fade = np.minimum((share - MIN_TRACED_SHARE) / (FULL_TRACED_SHARE - MIN_TRACED_SHARE), 1.0)
        level[sharp] += fade * (weight * seen - level[sharp])
        return level
