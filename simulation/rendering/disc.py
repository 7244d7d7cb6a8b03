"""Lights that are discs in the sky: how much falls on a surface, and rays spread over the disc."""

from dataclasses import dataclass

import numpy as np

from polhode.compiled import compiled
from polhode.lie import Array
from polhode.records import Ints
from polhode.simulation.rendering.directions import GOLDEN_ANGLE


def disc_irradiance(cosine: Array, radius_rad: float) -> Array:
    """Irradiance (n,) of a disc of radiance 1, relative to that of a whole sky; nothing stands before it.

    cosine (n,): between the normal and the disc's middle; radius_rad at most pi/2. Where the horizon cuts
    the disc, the form factor of a sphere (Howell, "Radiation configuration factors", B-43).
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


@dataclass(frozen=True)
class Stratum:
    """Which of its pixel's samples each of n rays is: what is spread over the samples is spread by it."""

    pixel: Ints
    """(n,)"""
    sample: int
    samples: int
    """of each pixel"""

    def __getitem__(self, which: Ints) -> "Stratum":
        return Stratum(self.pixel[which], self.sample, self.samples)

    def on_disc(self, use: int) -> Array:
        """A place (n, 2) on the unit disc for each ray.

        The samples of a pixel lie on a spiral that covers the disc evenly; each pixel turns and shifts the
        spiral by its own hash, so that no bands are seen. Each use has hashes of its own.
        """
        turn, shift = _hash(self.pixel, use)
        return spiral(self.sample + shift, self.samples, 2.0 * np.pi * turn)


def spiral(index: Array, count: int, turn_rad: Array | float = 0.0) -> Array:
    """Places (n, 2) on the unit disc: those of index (n,) in [0, count) on a spiral of ``count`` places."""
    radius, angle = np.sqrt(index / count), np.floor(index) * GOLDEN_ANGLE + turn_rad
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def rays_over_disc(direction_G: Array, radius_rad: float, stratum: Stratum) -> Array:
    """Unit directions (n, 3) to points of the disc around direction_G (3,), one for each ray."""
    place = np.tan(radius_rad) * stratum.on_disc(use=0)
    bent = direction_G + place @ _across(direction_G)
    return np.asarray(bent / np.sqrt(1.0 + np.einsum("nk,nk->n", place, place))[:, None])


def _across(direction: Array) -> Array:
    """Two unit vectors (2, 3) at right angles to a unit direction (3,) and to each other."""
    right = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right)])


@compiled
def _hash(pixel: Ints, use: int) -> tuple[Array, Array]:
    """Two uniform numbers (n,) in [0, 1) for each pixel."""
    first, second = np.empty(len(pixel)), np.empty(len(pixel))
    for n in range(len(pixel)):
        h = np.uint32(pixel[n] * 747796405 + use * 668265263 + 2891336453)
        for turn in range(2):
            h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(0x45D9F3B))
            h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x2C1B3C6D))
            h ^= h >> np.uint32(16)
            if turn == 0:
                first[n] = float(h) / 4294967296.0
        second[n] = float(h) / 4294967296.0
    return first, second
