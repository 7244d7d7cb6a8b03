"""The lights at one moment, seen from the body: Sun, Earth, lamp, and how an eclipse dims them."""

from dataclasses import dataclass

import numpy as np

from polhode.config import scene as config
from polhode.lie import Array


@dataclass(frozen=True)
class Lights:
    """The lights in G at one moment."""

    sun_direction_G: Array
    """(3,) unit, towards the Sun"""
    sun: float
    earth_direction_G: Array
    """(3,) unit"""
    earth: float
    lamp_G: Array
    """(3,) position [m]"""
    lamp: float
    """at 1 m"""


def lights_in_body(light: config.Light, X_GN: Array, X_GC: Array, t_s: float = 0.0) -> Lights:
    """Turn the scene's lights into G, t_s after the first frame; poses (4, 4), C the left camera."""

    def direction(vector_N: tuple[float, float, float]) -> Array:
        d = X_GN[:3, :3] @ np.array(vector_N)
        return np.asarray(d / np.linalg.norm(d))

    lamp_G = X_GC[:3, :3] @ np.array(light.lamp_position_m) + X_GC[:3, 3]
    sun, earth = direction(light.sun_direction_N), direction(light.earth_direction_N)
    factor = sunlight(light, t_s)
    return Lights(sun, factor * light.sun, earth, factor * light.earth, lamp_G, light.lamp)


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
