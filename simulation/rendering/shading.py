"""Light on surfaces: Sun, Earth, lamp, and what other parts of the body pass on.

Levels are relative to a white diffuse surface that faces the Sun.
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.records import Bools
from polhode.simulation.rendering.disc import disc_irradiance
from polhode.simulation.rendering.light import Lights
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.reflection import mirrored_earth, mirrored_share, reflected
from polhode.simulation.surface.materials import Surface


@dataclass(frozen=True)
class Arriving:
    """What n hits receive by way of the body itself."""

    bounced: Array | float = 0.0
    """(n,) irradiance of light that other parts reflect"""
    earth_share: Array | float = 1.0
    """(n,) share of the Earth's light that no part hides"""
    mirrored: Array | None = None
    """(n,) level of body and Earth in the mirror; None: the Earth alone, less what is hidden of it"""


def shade(
    hits: Hits,
    surface: Surface,
    to_viewer_G: Array,
    lights: Lights,
    caster: RayCaster,
    to_sun_G: Array | None = None,
    arriving: Arriving | None = None,
) -> Array:
    """Level (n,) of light that leaves the hits towards the viewer.

    to_viewer_G (n, 3) unit; to_sun_G (n, 3) unit, to the point of the Sun's disc that the shadow ray tries,
    its middle when absent; arriving: what the body itself adds and hides, nothing when absent.
    """
    level = _filled(surface, to_viewer_G, lights, arriving or Arriving())
    n = len(level)
    if lights.sun > 0:
        visible = caster.lit(hits, lights.sun_direction_G if to_sun_G is None else to_sun_G)
        toward = np.broadcast_to(lights.sun_direction_G, (n, 3))
        level[visible] += lights.sun * _reflected(surface, toward, to_viewer_G, visible)
    if lights.lamp > 0:
        offset = lights.lamp_G - hits.p_G
        reach = np.linalg.norm(offset, axis=1)
        toward = offset / reach[:, None]
        visible = caster.lit(hits, toward, reach)
        at_hit = lights.lamp / reach[visible] ** 2
        level[visible] += at_hit * _reflected(surface, toward, to_viewer_G, visible)
    return level


def _filled(surface: Surface, to_viewer_G: Array, lights: Lights, arriving: Arriving) -> Array:
    """Level (n,) of the Earth and of the body around, diffuse and mirrored."""
    cosine = surface.normal_G @ lights.earth_direction_G
    earth = lights.earth * arriving.earth_share * disc_irradiance(cosine, lights.earth_radius_rad)
    level = surface.albedo * (1.0 - surface.specular) * (earth + arriving.bounced)
    if arriving.mirrored is not None:
        return np.asarray(level + arriving.mirrored)
    share = mirrored_share(surface, to_viewer_G) * mirrored_earth(surface, to_viewer_G, lights)
    return np.asarray(level + lights.earth * arriving.earth_share * share)


def _reflected(surface: Surface, toward_G: Array, to_viewer_G: Array, where: Bools) -> Array:
    """Diffuse and specular reflection of unit light at the points ``where`` (n,)."""
    return np.asarray(
        reflected(
            surface.normal_G[where],
            toward_G[where],
            to_viewer_G[where],
            surface.albedo[where],
            surface.specular[where],
            surface.roughness[where] ** 4,
        )
    )
