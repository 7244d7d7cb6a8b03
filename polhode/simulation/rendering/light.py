"""The lights at one moment, seen from the body: Sun, Earth, lamp, and how an eclipse dims them."""

from dataclasses import dataclass, replace

import numpy as np

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, exp_so3

HALF_SKY_RAD = 0.5 * float(np.pi)
"""Radius of the largest disc: a sphere seen from outside covers less than half of the sky."""


@dataclass(frozen=True)
class Lights:
    """The lights in G at one moment."""

    sun_direction_G: Array
    """(3,) unit, towards the Sun's centre"""
    sun: float
    """level of a white surface that faces it"""
    earth_direction_G: Array
    """(3,) unit, towards the Earth's centre"""
    earth: float
    """radiance of its disc"""
    lamp_G: Array
    """(3,) position [m]"""
    lamp: float
    """at 1 m"""
    sun_radius_rad: float = 0.0
    earth_radius_rad: float = HALF_SKY_RAD

    def quantized(self, step: float, step_m: float) -> "Lights":
        """The same lights, directions rounded to ``step`` [rad] and the lamp's position to ``step_m``."""

        def rounded(direction: Array) -> Array:
            d = np.round(direction / step)
            return np.asarray(d / np.linalg.norm(d))

        return replace(
            self,
            sun_direction_G=rounded(self.sun_direction_G),
            earth_direction_G=rounded(self.earth_direction_G),
            lamp_G=np.round(self.lamp_G / step_m) * step_m if self.lamp > 0 else np.zeros(3),
        )

    def lamp_from(self, p_G: Array) -> tuple[Array, Array]:
        """Unit directions (n, 3) from points (n, 3) to the lamp, and distances (n,) [m]."""
        offset = self.lamp_G - p_G
        distance_m = np.linalg.norm(offset, axis=1)
        return offset / distance_m[:, None], distance_m

    @property
    def key(self) -> bytes:
        """Equal for equal lights."""
        numbers = (self.sun, self.earth, self.lamp, self.sun_radius_rad, self.earth_radius_rad)
        return np.concatenate([self.sun_direction_G, self.earth_direction_G, self.lamp_G, numbers]).tobytes()


def lights_in_body(light: config.Light, X_GN: Array, X_GC: Array, t_s: float = 0.0) -> Lights:
    """The scene's lights in G, t_s after the first frame; poses (4, 4), C the left camera."""

    def direction(vector_N: Array) -> Array:
        d = X_GN[:3, :3] @ vector_N
        return np.asarray(d / np.linalg.norm(d))

    lamp_G = X_GC[:3, :3] @ np.array(light.lamp_position_m) + X_GC[:3, 3]
    sun, earth = direction(np.array(light.sun_direction_N)), direction(earth_direction_N(light, t_s))
    factor = sunlight(light, t_s)
    return Lights(
        sun_direction_G=sun,
        sun=factor * light.sun,
        earth_direction_G=earth,
        earth=factor * light.earth,
        lamp_G=lamp_G,
        lamp=light.lamp,
        sun_radius_rad=0.5 * float(np.deg2rad(light.sun_diameter_deg)),
        earth_radius_rad=min(float(np.deg2rad(light.earth_radius_deg)), HALF_SKY_RAD),
    )


def earth_direction_N(light: config.Light, t_s: float) -> Array:
    """Direction (3,) towards the middle of the Earth, of any length, t_s after the first frame."""
    start_N, rate_deg_s = np.array(light.earth_direction_N), np.array(light.earth_rate_deg_s)
    if not rate_deg_s.any():
        return start_N
    return np.asarray(exp_so3(np.deg2rad(rate_deg_s) * t_s) @ start_N)


def sunlight(light: config.Light, t_s: float) -> float:
    """Share of the sunlight that an eclipse leaves, in [0, 1], t_s after the first frame.

    The Earth's limb crosses the Sun's disc as a straight edge at constant speed: the share is the uncovered
    area, smooth at both ends of the ramp. The Earth's own light takes the same factor.
    """
    eclipse = light.eclipse
    if eclipse.duration_s == 0:
        return 1.0
    outside_s = max(eclipse.start_s - t_s, t_s - eclipse.start_s - eclipse.duration_s)
    if outside_s <= 0:
        return 0.0
    if outside_s >= eclipse.ramp_s:
        return 1.0
    covered = np.arccos(2.0 * outside_s / eclipse.ramp_s - 1.0)
    return float(1.0 - (covered - np.sin(covered) * np.cos(covered)) / np.pi)


def disc_irradiance(cosine: Array, radius_rad: float) -> Array:
    """Irradiance (n,) of a disc of radiance 1, relative to that of a whole sky, without occlusion.

    cosine (n,): between the normal and the centre of the disc; radius_rad at most pi/2. Where the horizon
    cuts the disc, the form factor of a sphere (Howell, "Radiation configuration factors", B-43).
    """
    sine = np.sqrt(np.clip(1.0 - cosine**2, 1e-12, 1.0))
    s, c = np.sin(radius_rad), np.cos(radius_rad)
    whole = s * s * cosine
    cut = (
        0.5
        - np.arcsin(np.clip(c / sine, -1.0, 1.0)) / np.pi
        + cosine * s * s * np.arccos(np.clip(-c * cosine / (s * sine), -1.0, 1.0)) / np.pi
        - s * c * np.sqrt(np.clip(1.0 - (cosine / s) ** 2, 0.0, 1.0)) / np.pi
    )
    return np.where(cosine >= s, whole, np.where(cosine <= -s, 0.0, cut))
