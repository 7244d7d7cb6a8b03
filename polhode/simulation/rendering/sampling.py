"""Sampling patterns: directions evenly over the sphere, look-up of the nearest one, points on discs and in
pixels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
_SCATTER_USE = 1000
"""First of the hashes of scattered rays; those of discs are below."""
MAP_CELLS = 96
"""Cells along an edge of the map that finds the nearest direction."""


def even_directions(count: int) -> Array:
    """Unit directions (count, 3) on a Fibonacci spiral."""
    index = np.arange(count)
    z = 1.0 - (2.0 * index + 1.0) / count
    angle, flat = index * GOLDEN_ANGLE, np.sqrt(1.0 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def nearest_direction_map(directions: Array) -> NDArray[np.int32]:
    """Index of the nearest of directions (D, 3) in every cell of an octahedron unfolded onto a square."""
    x, y = ((grid + 0.5) / MAP_CELLS * 2.0 - 1.0 for grid in np.mgrid[:MAP_CELLS, :MAP_CELLS])
    z = 1.0 - np.abs(x) - np.abs(y)
    folded = z < 0.0
    x, y = (
        np.where(folded, np.copysign(1.0 - np.abs(y), x), x),
        np.where(folded, np.copysign(1.0 - np.abs(x), y), y),
    )
    cell = np.stack([x, y, z], axis=-1)
    cell /= np.linalg.norm(cell, axis=-1, keepdims=True)
    return np.asarray(cKDTree(directions).query(cell)[1], dtype=np.int32)


@compiled
def nearest_direction(x: float, y: float, z: float, nearest: NDArray[np.int32]) -> int:
    """Index of the direction near (x, y, z), any length, by the map of ``nearest_direction_map``."""
    size = abs(x) + abs(y) + abs(z)
    u, v = x / size, y / size
    if z < 0.0:
        u, v = np.copysign(1.0 - abs(y / size), x), np.copysign(1.0 - abs(x / size), y)
    cells = len(nearest)
    i = min(int((u + 1.0) * 0.5 * cells), cells - 1)
    j = min(int((v + 1.0) * 0.5 * cells), cells - 1)
    return int(nearest[i, j])


@dataclass(frozen=True)
class Stratum:
    """The sample of its pixel that each of n rays is, for stratified sampling over the samples of a pixel."""

    pixel: Ints
    """(n,)"""
    sample: int
    samples: int
    """of each pixel"""

    def __getitem__(self, which: Ints) -> "Stratum":
        return Stratum(self.pixel[which], self.sample, self.samples)

    def on_disc(self, use: int) -> Array:
        """A point (n, 2) on the unit disc for each ray.

        The samples of a pixel lie on a spiral that covers the disc evenly; a hash of the
        pixel rotates and shifts the spiral, so that no bands are visible. Each use has its own hashes.
        """
        turn, shift = _hash(self.pixel, use)
        return spiral_points(self.sample + shift, self.samples, 2.0 * np.pi * turn)


def spiral_points(index: Array, count: int, turn_rad: Array | float = 0.0) -> Array:
    """Points (n, 2) on the unit disc: those of index (n,) in [0, count) on a spiral of ``count`` points."""
    radius, angle = np.sqrt(index / count), np.floor(index) * GOLDEN_ANGLE + turn_rad
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def scattered_offsets(pixel: Ints, offset_px: Array, t_s: float) -> Array:
    """Positions (n, 2) of one sample in its pixels (n,) [px], from -1/2 to 1/2.

    The regular position (2,) is shifted by an amount drawn for each pixel, and wrapped into the pixel
    (Cranley and Patterson, "Randomization of number theoretic methods for multiple integration", 1976): the
    samples of a pixel stay as far apart, and over many pixels each of them is anywhere, whenever it is taken.
    Another time t_s draws other shifts.
    """
    shift = np.stack(_hash(pixel, _SCATTER_USE + round(1e3 * t_s)), axis=1)
    return np.asarray((offset_px + shift) % 1.0 - 0.5)


def rays_over_disc(direction_G: Array, radius_rad: float, stratum: Stratum) -> Array:
    """Unit directions (n, 3) to points of the disc around direction_G (3,), one for each ray."""
    right = np.cross(direction_G, np.eye(3)[np.argmin(np.abs(direction_G))])
    right /= np.linalg.norm(right)
    place = np.tan(radius_rad) * stratum.on_disc(use=0)
    bent = direction_G + place @ np.stack([right, np.cross(direction_G, right)])
    return np.asarray(bent / np.sqrt(1.0 + np.einsum("nk,nk->n", place, place))[:, None])


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
