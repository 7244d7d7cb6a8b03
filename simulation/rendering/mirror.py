"""What surfaces mirror of the body and of the Earth.

Rough surfaces take it from the probes' views, without noise. Sharp ones send one ray a hit, spread over the
GGX lobe from sample to sample of a pixel, and are shaded where it ends.
"""

from dataclasses import fields, replace

import numpy as np

from polhode.lie import Array
from polhode.records import Ints
from polhode.simulation.rendering.disc import Stratum
from polhode.simulation.rendering.indirect import Around, IndirectLight
from polhode.simulation.rendering.light import Lights
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.reflection import earth_seen, lobe_rays, mirrored_share
from polhode.simulation.rendering.shading import Arriving, shade
from polhode.simulation.rendering.skin import Skin
from polhode.simulation.surface.materials import Surface

FAINT, CLEAR = 0.06, 0.12
"""Share of mirrored light from which a sharp surface sends rays, and from which they are all it shows."""
SHARP_ALPHA = 0.07
"""GGX alpha below which a surface is sharp: the probes' views resolve about as much."""
DULLEST = 0.5
"""Least roughness of what such a ray meets: one ray cannot average sharper highlights."""
CORE = 0.92
"""Radius of the part of the lobe that is sent rays: a far tail that meets something bright makes specks."""
EARTH_EDGE = 0.5
"""Width of the Earth's edge for one ray, relative to the lobe that the rays of a pixel are spread over."""


class Mirror:
    """A body as its own surfaces show it."""

    def __init__(self, caster: RayCaster, skin: Skin, indirect: IndirectLight, bounces: int) -> None:
        self._caster, self._skin, self._indirect, self._bounces = caster, skin, indirect, bounces

    def level(
        self,
        hits: Hits,
        surface: Surface,
        to_viewer_G: Array,
        lights: Lights,
        around: Around,
        stratum: Stratum,
    ) -> Array:
        """Level (n,) of body and Earth as n hits mirror them towards the viewer, to_viewer_G (n, 3) unit."""
        level = around.mirrored(surface, to_viewer_G, hits.flat_normal_G, stratum)
        share = mirrored_share(surface, to_viewer_G)
        sharp = np.flatnonzero((surface.roughness**2 < SHARP_ALPHA) & (share > FAINT))
        if len(sharp) > 0:
            traced = self._traced(
                hits[sharp], _part(surface, sharp), to_viewer_G[sharp], lights, stratum[sharp]
            )
            fade = np.minimum((share[sharp] - FAINT) / (CLEAR - FAINT), 1.0)
            level[sharp] += fade * (traced - level[sharp])
        return level

    def _traced(
        self, hits: Hits, surface: Surface, to_viewer_G: Array, lights: Lights, stratum: Stratum
    ) -> Array:
        """Level (n,) that one ray a hit brings."""
        alpha = np.maximum(surface.roughness**2, 1e-3)
        lobe = (surface.normal_G, to_viewer_G, alpha, surface.specular)
        rays, weight = lobe_rays(*lobe, CORE * stratum.on_disc(use=1), hits.flat_normal_G)
        met = self._caster.next_hits(hits, rays)
        seen = lights.earth * earth_seen(rays, EARTH_EDGE * alpha, lights)
        seen[met.ray] = self._glow(met, -rays[met.ray], lights) if self._bounces else 0.0
        return weight * seen

    def _glow(self, hits: Hits, to_viewer_G: Array, lights: Lights) -> Array:
        """Level (n,) of hits in the mirror, under Sun, Earth and lamp."""
        surface = self._skin.evaluate(hits.face, hits.weights, hits.p_G, hits.normal_G)
        surface = replace(surface, roughness=np.maximum(surface.roughness, DULLEST))
        arriving = Arriving(earth_share=self._indirect.at(hits, lights).earth_share())
        return shade(hits, surface, to_viewer_G, lights, self._caster, arriving=arriving)


def _part(surface: Surface, which: Ints) -> Surface:
    return Surface(*(getattr(surface, field.name)[which] for field in fields(surface)))
