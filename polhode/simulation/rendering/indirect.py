"""Indirect light: reflected by other parts of the body, and the part of the Earth's light that they block.

It is gathered at probes (probes.py) and interpolated between them, so that it is free of noise: one
reflection from part to part, the Earth's disc as the body occludes it, and the reflection of both in glossy
surfaces.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array
from polhode.runtime.compiled import compiled
from polhode.simulation.bodies import Body
from polhode.simulation.rendering.appearance import SurfaceAppearance
from polhode.simulation.rendering.light import Lights, disc_irradiance
from polhode.simulation.rendering.probes import DARK, DIRECTIONS, PROBES, SKY, Neighbours, place_probes
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.reflection import glossy, lobe_ray
from polhode.simulation.rendering.sampling import (
    Stratum,
    nearest_direction,
    nearest_direction_map,
    spiral_points,
)
from polhode.simulation.surface.materials import Surface

CELL_RAD = float(np.sqrt(4.0 / DIRECTIONS))
"""Radius of the patch of sky that one direction of the probes represents."""
MIN_ALPHA2 = 0.2**2
"""Square of the smallest GGX alpha of highlights on other parts: the directions resolve no sharper ones."""
STEP_RAD, STEP_SHARE = 1.0 / 256.0, 0.005
"""Steps to which directions of lights are rounded, and position of the lamp relative to the body's size."""
STRONG_REFLECTANCE = 0.1
"""Reflectance at normal incidence (F0) above which a surface is a strong reflector."""
STRONG_LOBE_RAYS, WEAK_LOBE_RAYS = 48, 8
"""Rays per pixel in the lobe of a strong and of a weak reflector."""
MIN_WEIGHT = 0.05
"""Probes with a smaller weight are ignored."""


@dataclass(frozen=True)
class IndirectField:
    """Indirect light at one moment."""

    bounced: NDArray[np.float32]
    """(P, 3) irradiance vector in G of the light that other parts reflect onto each probe"""
    earth_share: NDArray[np.float32]
    """(P, 1) share of the Earth's light that no part blocks"""
    views: NDArray[np.float32]
    """(P, D) radiance of body and Earth that each probe sees in each direction, negative below its horizon"""
    nearest: NDArray[np.int32]
    """Map from directions to the views' columns"""


@dataclass(frozen=True)
class IndirectAtHits:
    """Indirect light at n hits."""

    fill: IndirectField
    near: Neighbours

    def bounced(self, normal_G: Array) -> Array:
        """Irradiance (n,) of light that other parts reflect, on shading normals (n, 3)."""
        return np.asarray(np.maximum(np.einsum("nk,nk->n", self.near.mean(self.fill.bounced), normal_G), 0.0))

    def earth_share(self) -> Array:
        """Share (n,) of the Earth's light that no part blocks."""
        alone = self.near.weight[:, 0] == 0
        return np.where(alone, 1.0, self.near.mean(self.fill.earth_share)[:, 0])

    def mirrored(self, surface: Surface, to_viewer_G: Array, flat_normal_G: Array, stratum: Stratum) -> Array:
        """Level (n,) of the body and the Earth, as the probes see them, in the specular lobe of the surface.

        to_viewer_G (n, 3) unit; flat_normal_G (n, 3) of the faces.
        """
        fill, near, s = self.fill, self.near, surface
        many, few = (
            # The samples of a pixel share these rays, on a spiral.
            spiral_points(
                np.arange(rays, dtype=np.float64) * stratum.samples + stratum.sample + 0.5,
                rays * stratum.samples,
            )
            for rays in (max(n // stratum.samples, 1) for n in (STRONG_LOBE_RAYS, WEAK_LOBE_RAYS))
        )
        probes = (near.index, near.weight, fill.views, fill.nearest)
        lobe = (s.normal_G, to_viewer_G, flat_normal_G, s.roughness**2, s.specular)
        return np.asarray(_mirrored(*probes, *lobe, many, few))


class IndirectLight:
    """The probes of a body and the surface around them, for the lights of any moment."""

    def __init__(
        self, body: Body, caster: RayCaster, appearance: SurfaceAppearance, bounces: int, probes: int = PROBES
    ) -> None:
        self._caster, self._bounces = caster, bounces
        self._probes = place_probes(body.mesh, caster, probes)
        self._points = points = self._probes.points
        self._surface = surface = appearance.at(points)
        self._reflectance = surface.albedo * (1.0 - surface.specular)
        mean = self._probes.mean
        self._albedo, self._specular = mean(self._reflectance), mean(surface.specular)
        upright = np.einsum("nk,nk->n", surface.normal_G, points.flat_normal_G)
        relief = 1.0 / np.clip(upright, 0.3, 1.0) ** 2 - 1.0
        self._alpha2 = np.maximum(mean(surface.roughness**4 + relief), MIN_ALPHA2)
        self._radius_m = body.radius_m
        self._known: dict[bytes, IndirectField] = {}
        self._nearest = nearest_direction_map(self._probes.directions_G)

    def at(self, hits: Hits, lights: Lights) -> IndirectAtHits:
        """Indirect light at n hits."""
        return IndirectAtHits(self.for_lights(lights), self._probes.around.near(hits.p_G, hits.normal_G))

    def for_lights(self, lights: Lights) -> IndirectField:
        """The indirect light under the lights of one moment.

        Lights are rounded to small steps, and the last two results are cached: both images of a pair, and the
        samples of a pixel under motion blur, share them. The result depends on the lights alone.
        """
        lights = lights.quantized(STEP_RAD, STEP_SHARE * self._radius_m)
        if lights.key not in self._known:
            self._known = {lights.key: self._found(lights), **dict([*self._known.items()][:1])}
        return self._known[lights.key]

    def _found(self, lights: Lights) -> IndirectField:
        probes, sun_G = self._probes, lights.sun_direction_G
        # Share of the patch of sky around each direction that the Earth's disc fills.
        off_middle = np.arccos(np.clip(probes.directions_G @ lights.earth_direction_G, -1.0, 1.0))
        inside = np.clip(0.5 + (lights.earth_radius_rad - off_middle) / (2.0 * CELL_RAD), 0.0, 1.0)
        share = _open_share(probes.sees, probes.normal_G, probes.directions_G, inside)
        level, clear = np.zeros((2, len(share)))
        if self._bounces:
            points, normal = self._points, self._surface.normal_G
            lit = self._caster.lit(points, sun_G)
            irradiance = lights.sun * lit * np.maximum(normal @ sun_G, 0.0)
            if lights.lamp > 0:
                toward, reach = lights.lamp_from(points.p_G)
                cosine = np.maximum(np.einsum("nk,nk->n", normal, toward), 0.0)
                irradiance += lights.lamp / reach**2 * cosine * self._caster.lit(points, toward, reach)
            level = probes.mean(self._reflectance * irradiance)
            cosine = probes.normal_G @ lights.earth_direction_G
            level += self._albedo * lights.earth * share * disc_irradiance(cosine, lights.earth_radius_rad)
            clear = np.where(self._specular > 0.0, lights.sun * probes.mean(lit.astype(np.float64)), 0.0)
        seen = (probes.sees, probes.directions_G, level, clear, lights.earth * inside)
        bounced, views = _gather(*seen, probes.normal_G, self._specular, self._alpha2, sun_G)
        earth_share = share[:, None].astype(np.float32)
        return IndirectField(bounced.astype(np.float32), earth_share, views, self._nearest)


@compiled
def _open_share(sees: NDArray[np.int16], normal: Array, directions: Array, inside: Array) -> Array:
    """Share (P,) of the disc's light above the horizon that comes from open sky; 1 where there is none."""
    share = np.empty(len(sees))
    of_disc = np.flatnonzero(inside > 0.0)
    for p in range(len(sees)):
        n = normal[p]
        everything, free = 1e-9, 1e-9
        for d in of_disc:
            cosine = n[0] * directions[d, 0] + n[1] * directions[d, 1] + n[2] * directions[d, 2]
            if cosine > 0.0:
                everything += cosine * inside[d]
                if sees[p, d] == SKY:
                    free += cosine * inside[d]
        share[p] = free / everything
    return share


@compiled
def _gather(
    sees: NDArray[np.int16],
    directions: Array,
    level: Array,
    clear: Array,
    sky: Array,
    normal: Array,
    f0: Array,
    alpha2: Array,
    sun: Array,
) -> tuple[Array, NDArray[np.float32]]:
    """Irradiance vector (P, 3) of the light that parts reflect onto each probe, and the views (P, D).

    Parts reflect a diffuse ``level`` (P,), and highlights of the Sun from the sunlit share ``clear`` (P,).
    """
    bounced = np.zeros((len(sees), 3))
    views = np.full(sees.shape, -1.0, np.float32)
    for p in range(len(sees)):
        for d in range(len(directions)):
            q = sees[p, d]
            if q >= 0:
                light = level[q]
                if clear[q] > 0.0:
                    light += clear[q] * _highlight(normal[q], directions[d], sun, alpha2[q], f0[q])
                for k in range(3):
                    bounced[p, k] += light * directions[d, k]
                views[p, d] = light
            elif q == SKY:
                views[p, d] = sky[d]
            elif q == DARK:
                views[p, d] = 0.0
    return bounced * (4.0 / len(directions)), views


@compiled
def _highlight(n: Array, from_viewer: Array, sun: Array, alpha2: float, f0: float) -> float:
    """Level of the Sun's highlight on a surface of normal n (3,), seen along a direction (3,)."""
    n_l = n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2]
    n_v = -(n[0] * from_viewer[0] + n[1] * from_viewer[1] + n[2] * from_viewer[2])
    if n_l <= 0.0 or n_v <= 0.0:
        return 0.0
    l_v = -(sun[0] * from_viewer[0] + sun[1] * from_viewer[1] + sun[2] * from_viewer[2])
    length = np.sqrt(max(2.0 + 2.0 * l_v, 1e-9))
    return float(glossy(n_l, max(n_v, 1e-3), min((n_l + n_v) / length, 1.0), 0.5 * length, alpha2, f0))


@compiled
def _mirrored(
    index: NDArray[np.int32],
    share: NDArray[np.float32],
    views: NDArray[np.float32],
    nearest: NDArray[np.int32],
    normal: Array,
    to_viewer: Array,
    horizon: Array,
    alpha: Array,
    f0: Array,
    many: Array,
    few: Array,
) -> Array:
    """Level (n,) by rays at points ``many`` (rays, 2) of the lobe, or ``few`` for weak reflectors."""
    out = np.zeros(len(index))
    for i in range(len(index)):
        if f0[i] <= 0.0 or share[i, 0] <= 0.0:
            continue
        places = many if f0[i] > STRONG_REFLECTANCE else few
        n, v, h = normal[i], to_viewer[i], horizon[i]
        for ray in range(len(places)):
            x, y, z, weight = lobe_ray(n, v, alpha[i], f0[i], places[ray, 0], places[ray, 1])
            below = 2.0 * min(x * h[0] + y * h[1] + z * h[2], 0.0)
            d = nearest_direction(x - below * h[0], y - below * h[1], z - below * h[2], nearest)
            seen, total = 0.0, 1e-9
            for k in range(index.shape[1]):
                if share[i, k] > MIN_WEIGHT and views[index[i, k], d] >= 0.0:
                    seen += share[i, k] * views[index[i, k], d]
                    total += share[i, k]
            out[i] += weight * seen / total
        out[i] /= len(places)
    return out
