"""The background of the target: a wall, the Earth and stars, as far as the scene has them.

Earth: a ball of radius 1 with oceans, land and clouds. Its air scatters as one layer: light along the view
grows with the air mass as 1 - exp(-depth), and falls off above the ground with a scale height of 8 km. The
air mass is Rozenberg's ("Twilight", 1966), 1 / (c + 0.025 exp(-11 c)) at cosine c from the zenith. Clouds and
coasts are noise with details down to about 5 km. The orbit (``light.earth_rate_deg_s``) moves the camera over
them; the Earth's own rotation, a fifteenth of that, does not.

Stars: points blurred by the lens at sub-pixel positions, fixed in N. Numbers follow the counts over the whole
sky, log10 N(< m) = 0.51 m + 0.64: 4 stars to magnitude 0, 1550 to 5, 9000 to 6.5 (Bright Star Catalogue,
Hoffleit and Warren 1991: 9096). Directions are uniform: no Milky Way.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, exp_so3
from polhode.runtime.compiled import compiled
from polhode.runtime.errors import InputError
from polhode.simulation.rendering.light import earth_direction_N, sunlight
from polhode.simulation.rendering.render import RenderedLight
from polhode.simulation.stereo_camera import Camera
from polhode.simulation.surface.noise import cell_at, fractal_at


class Sky:
    """The background of a scene; black, at no cost, if the scene has none."""

    def __init__(self, scene: config.Scene, seed: int) -> None:
        """Raises InputError: a disc of the Earth or a magnitude that cannot be drawn."""
        asked = scene.background
        self.wall = Wall(asked.wall, seed) if asked.wall.distance_m > 0.0 else None
        self._earth = Earth(scene.light, seed) if asked.earth else None
        self._stars = star_field(asked.faintest_magnitude, seed) if asked.stars else None
        self._star_level = asked.star_dn / scene.sensor.white_dn
        self._blur_px = scene.sensor.blur_px

    def background(
        self, picture: RenderedLight, camera: Camera, X_NK: Array, t_s: float
    ) -> tuple[Array, Array | None]:
        """Levels (H, W) of the picture with what is behind the target; light (H, W) of the stars, if any.

        X_NK (4, 4), or (S, 4, 4) during the exposure; t_s after the first frame. The light of the stars
        includes the lens blur, because stars are points, finer than the pixels. Earth and wall are rendered
        from one pose: motion hardly blurs them.
        """
        poses = X_NK.reshape(-1, 4, 4)
        middle = poses[len(poses) // 2]
        level, covered = picture.level, picture.covered
        if self.wall is not None:
            wall, there = self.wall.level(camera, middle)
            level = level + (1.0 - covered) * wall
            covered = np.maximum(covered, there)
        if self._earth is not None:
            level = level + (1.0 - covered) * self._earth.level(camera, middle, t_s)
        if self._stars is None:
            return level, None
        if self._earth is not None:
            rays_N = camera.pixel_directions @ middle[:3, :3].T
            covered = np.maximum(covered, self._earth.hides(rays_N, t_s).reshape(covered.shape))
        return level, self._star_level * image_of_stars(self._stars, camera, poses, self._blur_px, covered)


FULL_DISC = 0.22
"""Mean radiance of the full disc relative to a white surface, over many seeds: ``light.earth`` scales it."""
SCALE_HEIGHT = 8.0 / 6371.0
DEPTH = 0.16
"""Optical depth of the clear sky straight down."""
SKY = 0.42
"""Reflectance of an endlessly deep sky."""
LIMB_AIR_MASS = 40.0
TOP = 12.0
"""Height of the top of the atmosphere, in scale heights."""


class Earth:
    """The Earth's disc, where ``light.earth_direction_N`` points."""

    def __init__(self, light: config.Light, seed: int) -> None:
        """Raises InputError: the disc is wider than half the sky."""
        if light.earth_radius_deg >= 90:
            raise InputError(
                f"scene.light.earth_radius_deg: {light.earth_radius_deg:g} degrees hide half the sky or "
                "more; give less than 90 (66 at 600 km)"
            )
        self._light = light
        self._seed = seed
        self._sun_N = _unit(light.sun_direction_N)
        # The noise is anisotropic along its axes, which must not be parallel to those of an image.
        self._turn = exp_so3(np.random.default_rng([seed, 0x5]).normal(size=3))
        self._distance = 1.0 / np.sin(np.deg2rad(light.earth_radius_deg))
        self._known: dict[bytes, Array] = {}

    def level(self, camera: Camera, X_NK: Array, t_s: float) -> Array:
        """Light (H, W) of a camera's view at X_NK (4, 4), t_s after the first frame."""
        factor = sunlight(self._light, t_s)
        if factor * self._light.earth == 0.0:
            return np.zeros((camera.height_px, camera.width_px))
        R_NK, middle_N = X_NK[:3, :3], _unit(earth_direction_N(self._light, t_s))
        key = R_NK.tobytes() + camera.X_CK.tobytes() + middle_N.tobytes()
        # Relative to a sunlit white surface; cached while neither camera nor Earth turns.
        known = self._known.get(key)
        if known is None:
            rays_N = camera.pixel_directions @ R_NK.T
            directions = (rays_N @ self._turn, middle_N @ self._turn, self._sun_N @ self._turn)
            flat = _reflectance(*directions, self._distance, 1.0 / camera.K[0, 0], self._seed)
            # There are two cameras: a third view means that they or the Earth turn, and no view will recur.
            if len(self._known) >= 2:
                self._known.clear()
            known = np.asarray(flat).reshape(camera.height_px, camera.width_px)
            self._known[key] = known
        return factor * self._light.earth / FULL_DISC * known

    def hides(self, direction_N: Array, t_s: float = 0.0) -> Array:
        """Whether the Earth covers directions (n, 3), t_s after the first frame."""
        middle_N = _unit(earth_direction_N(self._light, t_s))
        return np.asarray(direction_N @ middle_N > np.sqrt(1.0 - self._distance**-2))


def _unit(vector: tuple[float, float, float] | Array) -> Array:
    return np.asarray(np.asarray(vector) / np.linalg.norm(vector))


@compiled
def _reflectance(
    rays: Array, middle: Array, sun: Array, distance: float, pixel_rad: float, seed: int
) -> Array:
    """Light (n,) along unit rays (n, 3) from a ball of radius 1, relative to a white surface."""
    out = np.zeros(len(rays))
    for i in range(len(rays)):
        ray = rays[i]
        ahead = distance * float(ray @ middle)
        miss = math.sqrt(max(distance * distance - ahead * ahead, 0.0))
        if ahead <= 0.0 or miss > 1.0 + TOP * SCALE_HEIGHT:
            continue
        on_ball = min(max((1.0 - miss) / (ahead * pixel_rad) + 0.5, 0.0), 1.0)
        if on_ball < 1.0:
            tangent = ahead * ray - distance * middle
            day = _daylight(float(tangent @ sun) / miss)
            depth = 2.0 * LIMB_AIR_MASS * DEPTH * math.exp(-max(miss - 1.0, 0.0) / SCALE_HEIGHT)
            out[i] += (1.0 - on_ball) * day * SKY * (1.0 - math.exp(-depth))
        if on_ball > 0.0:
            up = math.sqrt(max(1.0 - miss * miss, 0.0))
            place = (ahead - up) * ray - distance * middle
            footprint = (ahead - up) * pixel_rad / max(up, 0.02)
            out[i] += on_ball * _disc(place, up, ray, sun, footprint, seed)
    return out


@compiled
def _disc(place: Array, up: float, ray: Array, sun: Array, footprint: float, seed: int) -> float:
    """Light from a point (3,) on the ball, seen along a ray at cosine ``up`` from its zenith."""
    sun_up = float(place @ sun)
    day = _daylight(sun_up)
    if day == 0.0:
        return 0.0
    clear = math.exp(-DEPTH * _air_mass(up))
    ground, clouds = _surface(place, footprint, seed)
    direct = max(sun_up, 0.0) * math.exp(-DEPTH * _air_mass(max(sun_up, 0.0)))
    half = sun - ray
    tilt = float(half @ place) ** 2 / float(half @ half)
    glint = 0.12 * math.exp(-(1.0 / max(tilt, 1e-3) - 1.0) / 0.03) if ground < 0.06 else 0.0
    below = (1.0 - clouds) * (ground + glint) + clouds * (0.5 + 0.35 * clouds)
    return clear * below * (direct + 0.12 * day) + day * SKY * (1.0 - clear)


@compiled
def _surface(place: Array, footprint: float, seed: int) -> tuple[float, float]:
    """Reflectance of the ground at a point, and cloud cover; without details smaller than the footprint."""
    x, y, z = place
    finest = max(int(math.log2(0.25 / footprint)), 2)
    region, gx, gy, gz = fractal_at(2.5 * x, 2.5 * y, 2.5 * z, 2, seed + 11)
    # Clouds are drawn out along lines of equal pressure: the gradient rotated about the vertical.
    x, y, z = x + 0.03 * (y * gz - z * gy), y + 0.03 * (z * gx - x * gz), z + 0.03 * (x * gy - y * gx)
    wisps, _, _, _ = fractal_at(8.0 * x, 8.0 * y, 8.0 * z, 4, seed + 22)
    thick = wisps + 0.8 * region
    if thick > -0.5 and finest > 4:
        puffs, _, _, _ = fractal_at(90.0 * x, 90.0 * y, 90.0 * z, min(finest - 4, 5), seed + 33)
        thick += puffs
    clouds = _ramp(thick, 0.03, 0.65)
    if clouds > 0.95:
        return 0.03, clouds
    x, y, z = place
    land, _, _, _ = fractal_at(1.3 * x, 1.3 * y, 1.3 * z, 4, seed)
    if abs(land - 0.1) < 0.25:
        land, _, _, _ = fractal_at(1.3 * x, 1.3 * y, 1.3 * z, min(finest, 9), seed)
    if land < 0.1:
        return 0.03, clouds
    dry, _, _, _ = fractal_at(9.0 * x, 9.0 * y, 9.0 * z, min(finest, 5), seed + 44)
    return 0.12 + 0.12 * dry, clouds


@compiled
def _air_mass(up: float) -> float:
    return 1.0 / (up + 0.025 * math.exp(-11.0 * up))


@compiled
def _daylight(sun_up: float) -> float:
    """Light of the sky where the Sun's cosine from the zenith is ``sun_up``; dusk ends at -7 degrees."""
    return 1.0 - math.exp(-max(sun_up + 0.12, 0.0) / 0.12)


@compiled
def _ramp(value: float, low: float, high: float) -> float:
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


SLOPE, AT_ZERO = 0.51, 0.64
MAX_MAGNITUDE = 10.0
"""The law of star counts is valid up to this magnitude, and fainter stars are invisible."""


@dataclass(frozen=True)
class Stars:
    """n stars, the brightest first."""

    direction_N: Array
    """(n, 3) unit"""
    magnitude: Array
    """(n,)"""


def star_field(faintest_magnitude: float, seed: int) -> Stars:
    """The stars down to a magnitude; a fainter limit adds stars without changing the others.

    Raises InputError: the limit is beyond magnitude 10.
    """
    if faintest_magnitude > MAX_MAGNITUDE:
        raise InputError(
            f"scene.background.faintest_magnitude: {faintest_magnitude:g} is fainter than {MAX_MAGNITUDE:g}, "
            "where star counts follow another law; give a smaller number"
        )
    # A Poisson process of the cumulative number: its n-th event is the n-th brightest star.
    expected = 10 ** (SLOPE * faintest_magnitude + AT_ZERO)
    most = int(expected + 8 * np.sqrt(expected) + 8)
    number = np.cumsum(np.random.default_rng([seed, 0x4, 0]).exponential(size=most))
    magnitude = (np.log10(number) - AT_ZERO) / SLOPE
    direction = np.random.default_rng([seed, 0x4, 1]).normal(size=(most, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    kept = magnitude <= faintest_magnitude
    return Stars(direction[kept], magnitude[kept])


def image_of_stars(stars: Stars, camera: Camera, X_NK: Array, blur_px: float, covered: Array) -> Array:
    """Light (H, W) of the stars: 1 in the brightest pixel of one of magnitude 0 at the pixel's centre.

    X_NK (S, 4, 4): camera poses during the exposure, each with its share of the light. ``covered`` (H, W):
    share of each pixel that hides the stars. The lens spreads a star over a Gaussian of ``blur_px``.
    """
    sigma = max(blur_px, 1e-6)

    def share(offset_px: Array) -> Array:
        """Share of a Gaussian line of light that falls on pixels whose centres lie at offsets from it."""
        return np.asarray(ndtr((offset_px + 0.5) / sigma) - ndtr((offset_px - 0.5) / sigma))

    height, width = camera.height_px, camera.width_px
    image = np.zeros((height, width))
    flux = 10 ** (-0.4 * stars.magnitude) / float(share(np.zeros(1))[0] ** 2)
    reach = int(np.ceil(4.0 * blur_px + 1.0))
    steps = np.arange(-reach, reach + 1)
    for X in X_NK:
        uv, index = camera.project_visible(stars.direction_N @ X[:3, :3], margin_px=reach)
        nearest = np.clip(np.rint(uv).astype(int), 0, [width - 1, height - 1])
        seen = 1.0 - covered[nearest[:, 1], nearest[:, 0]]
        # Each pixel takes the light that falls on its square.
        places = [np.rint(uv[:, axis, None]).astype(int) + steps for axis in (0, 1)]
        along_u, along_v = (share(place - uv[:, axis, None]) for axis, place in enumerate(places))
        u, v = places[0][:, None, :], places[1][:, :, None]
        own = flux[index] * seen / len(X_NK)
        light = own[:, None, None] * along_u[:, None, :] * along_v[:, :, None]
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        np.add.at(image.reshape(-1), (v * width + u)[inside], light[inside])
    return image


MEAN = 0.45
"""Mean reflectance of the wall."""
CLOUDS, PATCHES, GRAIN = 0.2, 0.22, 0.18
"""Largest deviations from it by each part of the pattern."""
CLOUD_SIZE, GRAIN_SIZE = 4.0, 0.3
"""Sizes relative to that of the patches."""


class Wall:
    """The plane through (0, 0, distance) of N, turned about that point: a random pattern, evenly lit.

    Unlike the Earth it has parallax. The pattern has flat patches with sharp edges, larger clouds and a fine
    grain.
    """

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
