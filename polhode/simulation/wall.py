"""A wall behind the target: a plane at a finite distance with a random pattern, evenly lit.

Unlike the Earth it has parallax: it moves in the image when the camera moves, and its two images differ by a
disparity. The pattern has flat patches with sharp edges, larger clouds and a fine grain.
"""

import numpy as np

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, exp_so3
from polhode.runtime.compiled import compiled
from polhode.runtime.errors import InputError
from polhode.simulation.stereo_camera import Camera
from polhode.simulation.surface.noise import cell_at, fractal_at

MEAN = 0.45
"""Mean reflectance of the wall."""
CLOUDS, PATCHES, GRAIN = 0.2, 0.22, 0.18
"""Largest deviations from it by each part of the pattern."""
CLOUD_SIZE, GRAIN_SIZE = 4.0, 0.3
"""Sizes relative to that of the patches."""


class Wall:
    """The plane through (0, 0, distance) of N, turned about that point."""

    def __init__(self, settings: config.Wall, seed: int) -> None:
        self._settings = settings
        self._seed = seed
        self._axes_N = exp_so3(np.deg2rad(settings.turn_deg))
        self._point_N = np.array([0.0, 0.0, settings.distance_m])
        self._known: dict[bytes, tuple[Array, Array]] = {}

    def depth_behind(self, p_N: Array) -> Array:
        """Distance (n,) of the wall's plane behind points (n, 3) along its normal [m]; negative: before."""
        return np.asarray((self._point_N - p_N) @ self._axes_N[:, 2])

    def require_behind(self, p_N: Array, radius_m: float) -> None:
        """Raise InputError if a body of that radius about any of the points (n, 3) reaches the wall."""
        nearest = float(self.depth_behind(p_N).min())
        if nearest < radius_m:
            raise InputError(
                "scene.background.wall: the target reaches the wall or is behind it: its centre comes within "
                f"{nearest:.3g} m of the wall and it extends {radius_m:.3g} m; give a larger distance_m"
            )

    def level(self, camera: Camera, X_NK: Array) -> tuple[Array, Array]:
        """Light (H, W) of the wall from a camera at X_NK (4, 4), and where it is (H, W), 0 or 1."""
        key = X_NK.tobytes() + camera.X_CK.tobytes()
        known = self._known.get(key)
        if known is None:
            settings, shape = self._settings, (camera.height_px, camera.width_px)
            rays_W, eye_W, reach = self._reach(camera, X_NK)
            there = np.isfinite(reach)
            ahead = np.where(there, reach, 0.0)
            place = eye_W + ahead[:, None] * rays_W
            # A pixel's side on the wall, without the foreshortening.
            side = ahead * camera.pixel_directions[:, 2] / camera.K[0, 0]
            unit = settings.pattern_m
            albedo = _pattern(place[:, :2] / unit, side / unit, settings.contrast, self._seed)
            level = np.where(there, settings.brightness * albedo, 0.0)
            # There are two cameras: a third view means that they move, and no view will recur.
            if len(self._known) >= 2:
                self._known.clear()
            known = level.reshape(shape), there.astype(np.float64).reshape(shape)
            self._known[key] = known
        return known

    def depth(self, camera: Camera, X_NK: Array) -> tuple[Array, Array]:
        """Depth of the wall along the optical axis [m], and the cosine between ray and normal (H, W), seen
        from X_NK (4, 4); NaN where it is not."""
        rays_W, _, reach = self._reach(camera, X_NK)
        cosine = np.where(np.isfinite(reach), np.abs(rays_W[:, 2]), np.nan)
        shape = camera.height_px, camera.width_px
        return (reach * camera.pixel_directions[:, 2]).reshape(shape), cosine.reshape(shape)

    def _reach(self, camera: Camera, X_NK: Array) -> tuple[Array, Array, Array]:
        """Rays (n, 3) and eye (3,) in the wall's axes, and distance (n,) of the wall [m], NaN where none."""
        rays_W = camera.pixel_directions @ (self._axes_N.T @ X_NK[:3, :3]).T
        eye_W = self._axes_N.T @ (X_NK[:3, 3] - self._point_N)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = -eye_W[2] / rays_W[:, 2]
            # Along rays that nearly graze the wall, it ends at 100 times its distance from the origin of N.
            there = (reach > 0.0) & (reach < 100.0 * self._settings.distance_m)
        return rays_W, eye_W, np.where(there, reach, np.nan)


@compiled
def _pattern(place: Array, side: Array, contrast: float, seed: int) -> Array:
    """Reflectance (n,) at places (n, 2), the mean of four points of a pixel of that side (n,)."""
    out = np.empty(len(place))
    for i in range(len(place)):
        x, y, step = place[i, 0], place[i, 1], 0.25 * side[i]
        octaves = 3 if step < 0.05 * GRAIN_SIZE else 1
        clouds = fractal_at(x / CLOUD_SIZE, y / CLOUD_SIZE, 0.31, 3, seed + 5)[0]
        total = 0.0
        for corner in range(4):
            u = x + step * (1.0 if corner & 1 else -1.0)
            v = y + step * (1.0 if corner & 2 else -1.0)
            grain = fractal_at(u / GRAIN_SIZE, v / GRAIN_SIZE, 0.77, octaves, seed + 9)[0]
            total += PATCHES * cell_at(u, v, 0.5, seed + 7) + GRAIN * grain
        value = MEAN + contrast * (CLOUDS * clouds + 0.25 * total)
        out[i] = min(max(value, 0.01), 0.99)
    return out
