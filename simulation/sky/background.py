"""The background of the target: Earth and stars, as far as the scene has them."""

import numpy as np

from polhode.config import scene as config
from polhode.lie import Array
from polhode.simulation.camera.cameras import Camera
from polhode.simulation.rendering.render import RenderedLight
from polhode.simulation.sky.earth import Earth
from polhode.simulation.sky.stars import image_of_stars, star_field


class Sky:
    """The background of a scene; black, at no cost, if the scene has none."""

    def __init__(self, scene: config.Scene, seed: int) -> None:
        """Raises InputError: a disc of the Earth or a magnitude that cannot be drawn."""
        asked = scene.background
        self._earth = Earth(scene.light, seed) if asked.earth else None
        self._stars = star_field(asked.faintest_magnitude, seed) if asked.stars else None
        self._star_level = asked.star_dn / scene.sensor.white_dn
        self._blur_px = scene.sensor.blur_px

    def background(
        self, picture: RenderedLight, camera: Camera, X_NK: Array, t_s: float
    ) -> tuple[Array, Array | None]:
        """Levels (H, W) of the picture with the Earth behind the target; light (H, W) of the stars, if any.

        X_NK (4, 4), or (S, 4, 4) during the exposure; t_s after the first frame. The light of the stars
        includes the lens blur, because stars are points, finer than the pixels. The Earth is rendered from
        one pose: motion hardly blurs it.
        """
        poses = X_NK.reshape(-1, 4, 4)
        level, covered = picture.level, picture.covered
        if self._earth is not None:
            earth = self._earth.level(camera, poses[len(poses) // 2], t_s)
            level = level + (1.0 - covered) * earth
        if self._stars is None:
            return level, None
        if self._earth is not None:
            rays_N = camera.pixel_directions @ poses[len(poses) // 2, :3, :3].T
            covered = np.maximum(covered, self._earth.hides(rays_N).reshape(covered.shape))
        return level, self._star_level * image_of_stars(self._stars, camera, poses, self._blur_px, covered)
