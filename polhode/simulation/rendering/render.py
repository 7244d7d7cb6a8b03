"""One image: rays, hits, materials, light, and the mean over the samples of each pixel."""

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, inverse_pose
from polhode.simulation.bodies import Body
from polhode.simulation.rendering.appearance import SurfaceAppearance
from polhode.simulation.rendering.indirect import IndirectLight
from polhode.simulation.rendering.light import lights_in_body
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.rendering.sampling import Stratum, rays_over_disc, scattered_offsets
from polhode.simulation.rendering.shading import IncidentLight, SpecularTracer, shade
from polhode.simulation.stereo_camera import Camera, sample_offsets

PIXELS_A_PROBE = 60
"""Pixels of the image per probe of indirect light;"""
PROBES = (2000, 8000)
"""bounds on the number of probes."""


@dataclass(frozen=True)
class RenderedLight:
    """Light that the lens focuses on the sensor."""

    level: Array
    """(H, W) light, 1 for a white surface that faces the Sun"""
    covered: Array
    """(H, W) share of each pixel that the target covers"""


class Renderer:
    """Renders a body in its light from any pose."""

    def __init__(self, body: Body, scene: config.Scene, seed: int) -> None:
        self._body = body
        self.light = scene.light
        self._samples, self._scattered = scene.render.samples, scene.render.scattered
        self.caster = RayCaster(body)
        self.appearance = SurfaceAppearance(body, scene.body, seed)
        self._bounces = scene.render.bounces
        pixels = scene.rig.width_px * scene.rig.height_px
        self._probes = int(np.clip(pixels // PIXELS_A_PROBE, *PROBES))

    def under(self, light: config.Light) -> "Renderer":
        """The same body under other light; what does not depend on the light is shared."""
        _ = self._indirect  # built before it is shared
        other = copy(self)
        other.light = light
        return other

    @cached_property
    def _indirect(self) -> IndirectLight:
        """Built when first needed, which takes about a second."""
        return IndirectLight(self._body, self.caster, self.appearance, self._bounces, self._probes)

    def picture(self, camera: Camera, X_NK: Array, X_NG: Array, t_s: float = 0.0) -> RenderedLight:
        """Render what a camera at X_NK sees of the target at X_NG, t_s after the first frame.

        Poses are (4, 4), or (S, 4, 4) with one pose per sample of a pixel, which gives motion blur.
        """
        offsets = sample_offsets(self._samples)
        poses_NK, poses_NG = (np.broadcast_to(X, (len(offsets), 4, 4)) for X in (X_NK, X_NG))
        level, covered = np.zeros((2, camera.width_px * camera.height_px))
        for i, (X_NK, X_NG) in enumerate(zip(poses_NK, poses_NG, strict=True)):
            X_GN = inverse_pose(X_NG)
            X_GK = X_GN @ X_NK
            lights = lights_in_body(self.light, X_GN, X_GK @ inverse_pose(camera.X_CK), t_s)
            # Pixels whose ray intersects the body's bounding sphere.
            centre_K = inverse_pose(X_GK)[:3, 3]
            distance_m = float(np.linalg.norm(centre_K))
            angle = np.arcsin(min(self._body.radius_m / distance_m, 1.0)) + 2.0 / camera.K[0, 0]
            pixels = np.flatnonzero(camera.pixel_directions @ (centre_K / distance_m) > np.cos(angle))
            place_px = scattered_offsets(pixels, offsets[i], t_s) if self._scattered else offsets[i]
            v, u = np.divmod(pixels, camera.width_px)
            rays_G = camera.directions(np.stack([u, v], axis=1) + place_px) @ X_GK[:3, :3].T
            hits = self.caster.first_hits(X_GK[:3, 3], rays_G)
            surface = self.appearance.at(hits)
            to_viewer = -rays_G[hits.ray]
            stratum = Stratum(pixels[hits.ray], i, len(offsets))
            to_sun = rays_over_disc(lights.sun_direction_G, lights.sun_radius_rad, stratum)
            incident = None
            if lights.earth != 0 or self._bounces:
                around = self._indirect.at(hits, lights)
                mirror = SpecularTracer(self.caster, self.appearance, self._indirect, self._bounces)
                mirrored = mirror.level(hits, surface, to_viewer, lights, around, stratum)
                bounced = around.bounced(surface.normal_G)
                incident = IncidentLight(bounced, around.earth_share(), mirrored)
            level[stratum.pixel] += shade(hits, surface, to_viewer, lights, self.caster, to_sun, incident)
            covered[stratum.pixel] += 1.0
        shape = (camera.height_px, camera.width_px)
        return RenderedLight(level.reshape(shape) / len(offsets), covered.reshape(shape) / len(offsets))
