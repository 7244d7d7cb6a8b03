"""Solid (three-dimensional) noise: textures that need no unwrapping and never repeat between faces.

Lattice values come from an integer hash, so a seed gives the same texture on every machine.
Gradient-free value noise with quintic interpolation; cells after Worley, "A cellular texture basis
function", SIGGRAPH 1996.
"""

import numpy as np
from numba import njit

from polhode.lie import Array
from polhode.records import Ints


@njit(cache=True)
def _hash_unit(i: int, j: int, k: int, seed: int) -> float:
    """Lattice point and seed -> uniform number in [0, 1)."""
    h = np.uint32(i * 73856093) ^ np.uint32(j * 19349663) ^ np.uint32(k * 83492791)
    h ^= np.uint32(seed * 374761393)
    for _ in range(2):
        h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(0x45D9F3B))
    return float(h ^ (h >> np.uint32(16))) / 4294967296.0


@njit(cache=True)
def _value_noise(x: float, y: float, z: float, seed: int) -> float:
    """Smooth noise in [-1, 1], feature size 1."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w = x - i, y - j, z - k
    u = u * u * u * (u * (u * 6.0 - 15.0) + 10.0)
    v = v * v * v * (v * (v * 6.0 - 15.0) + 10.0)
    w = w * w * w * (w * (w * 6.0 - 15.0) + 10.0)
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if c else 1.0 - w)
                total += weight * _hash_unit(i + a, j + b, k + c, seed)
    return 2.0 * total - 1.0


@njit(cache=True)
def _fractal(p: Array, scale_m: Array, octaves: int, seed: Ints) -> Array:
    out = np.empty(len(p))
    for n in range(len(p)):
        s, amplitude, total, norm = 1.0 / scale_m[n], 1.0, 0.0, 0.0
        for octave in range(octaves):
            shift = 17.31 * octave
            total += amplitude * _value_noise(
                p[n, 0] * s + shift, p[n, 1] * s - shift, p[n, 2] * s + 0.5 * shift, seed[n] + octave
            )
            norm += amplitude
            s *= 2.03
            amplitude *= 0.6
        out[n] = total / norm
    return out


@njit(cache=True)
def _cells(p: Array, scale_m: Array, seed: Ints) -> Array:
    out = np.empty(len(p))
    for n in range(len(p)):
        x, y, z = p[n, 0] / scale_m[n], p[n, 1] / scale_m[n], p[n, 2] / scale_m[n]
        i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        best, value, s = 1e9, 0.0, seed[n]
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                for c in range(k - 1, k + 2):
                    dx = a + _hash_unit(a, b, c, s) - x
                    dy = b + _hash_unit(a, b, c, s + 1) - y
                    dz = c + _hash_unit(a, b, c, s + 2) - z
                    distance = abs(dx) + abs(dy) + abs(dz)
                    if distance < best:
                        best, value = distance, _hash_unit(a, b, c, s + 3)
        out[n] = 2.0 * value - 1.0
    return out


def fractal(p_G: Array, scale_m: Array, seed: Ints, octaves: int = 5) -> Array:
    """Fractal noise in [-1, 1] at points (n, 3) [m]; largest feature scale_m (n,) [m], integer seed (n,)."""
    return np.asarray(_fractal(np.ascontiguousarray(p_G), scale_m, octaves, seed))


def cells(p_G: Array, scale_m: Array, seed: Ints) -> Array:
    """One uniform value in [-1, 1] per random cell of size scale_m (n,) [m]: patches with sharp edges."""
    return np.asarray(_cells(np.ascontiguousarray(p_G), scale_m, seed))


def fractal_gradient(p_G: Array, scale_m: Array, seed: Ints, octaves: int = 3) -> Array:
    """Gradient of ``fractal`` times scale_m, (n, 3) dimensionless, by central differences."""
    step = 0.02 * scale_m
    columns = []
    for axis in range(3):
        d = np.zeros_like(p_G)
        d[:, axis] = step
        columns.append(fractal(p_G + d, scale_m, seed, octaves) - fractal(p_G - d, scale_m, seed, octaves))
    return np.stack(columns, axis=1) / 0.04
