"""One image: rays, hits, materials, light, and the mean over the samples of each pixel."""

from dataclasses import dataclass

import numpy as np

from polhode.config import scene as config
from polhode.lie import Array, inverse_pose
from polhode.records import Ints
from simulation.bodies import Body
from simulation.cameras import Camera, sample_offsets
from simulation.raycast import Hits, RayCaster
from simulation.shading import Lights, lights_in_body, shade
from simulation.skin import Skin


@dataclass(frozen=True)
class Picture:
    """What the lens forms on the sensor."""

    level: Array
    """(H, W) light, 1 for a white surface that faces the Sun"""
    covered: Array
    """(H, W) share of each pixel that the target covers"""


class Renderer:
    """A body and its light, ready to be seen from anywhere."""

    def __init__(self, body: Body, scene: config.Scene, seed: int) -> None:
        self._body = body
        self._light = scene.light
        self._samples = scene.render.samples
        self._caster = RayCaster(body)
        self._skin = Skin(body, scene.body, seed)

    def picture(self, camera: Camera, X_NK: Array, X_NG: Array) -> Picture:
        """Render a camera at X_NK (4, 4) and the target at X_NG (4, 4)."""
        X_GN = inverse_pose(X_NG)
        X_GK = X_GN @ X_NK
        pixels = self._pixels_near_body(camera, X_GK)
        rays_K = _sample_directions(camera, pixels, self._samples)
        rays_G = rays_K @ X_GK[:3, :3].T
        hits = self._caster.first_hits(X_GK[:3, 3], rays_G)
        level = self._levels(hits, rays_G, lights_in_body(self._light, X_GN, X_GK))
        pixel_of_hit = pixels[hits.ray // self._samples]
        return self._average(camera, pixel_of_hit, level)

    def depth_m(self, camera: Camera, X_NK: Array, X_NG: Array) -> Array:
        """Depth (H, W) along the optical axis at pixel centres [m], NaN beside the body."""
        X_GK = inverse_pose(X_NG) @ X_NK
        hits = self._caster.first_hits(X_GK[:3, 3], camera.pixel_directions @ X_GK[:3, :3].T)
        depth = np.full(camera.width_px * camera.height_px, np.nan)
        depth[hits.ray] = hits.distance_m * camera.pixel_directions[hits.ray, 2]
        return depth.reshape(camera.height_px, camera.width_px)

    def _pixels_near_body(self, camera: Camera, X_GK: Array) -> Ints:
        """Pixels whose ray passes the body's bounding sphere."""
        centre_K = inverse_pose(X_GK)[:3, 3]
        distance = float(np.linalg.norm(centre_K))
        margin_rad = 2.0 / camera.K[0, 0]
        angle = np.arcsin(min(self._body.radius_m / distance, 1.0)) + margin_rad
        return np.flatnonzero(camera.pixel_directions @ (centre_K / distance) > np.cos(angle))

    def _levels(self, hits: Hits, rays_G: Array, lights: Lights) -> Array:
        surface = self._skin.evaluate(hits.face, hits.weights, hits.p_G, hits.normal_G)
        return shade(hits, surface, -rays_G[hits.ray], lights, self._caster)

    def _average(self, camera: Camera, pixel: Ints, level: Array) -> Picture:
        count = camera.width_px * camera.height_px
        shape = (camera.height_px, camera.width_px)
        total = np.bincount(pixel, weights=level, minlength=count) / self._samples
        covered = np.bincount(pixel, minlength=count) / self._samples
        return Picture(total.reshape(shape), covered.reshape(shape))


def _sample_directions(camera: Camera, pixels: Ints, samples: int) -> Array:
    """Unit rays (n * samples, 3) in the camera, the samples of a pixel side by side."""
    v, u = np.divmod(pixels, camera.width_px)
    centres = np.stack([u, v], axis=1).astype(np.float64)
    return camera.directions((centres[:, None] + sample_offsets(samples)).reshape(-1, 2))
