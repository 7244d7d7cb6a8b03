"""Solid (three-dimensional) noise: textures without unwrapping that do not repeat between faces.

Lattice values come from an integer hash, so a seed gives the same texture on every machine. Value noise with
quintic interpolation; cells after Worley, "A cellular texture basis function", SIGGRAPH 1996.

The functions ``..._at`` serve one point inside compiled loops, with lengths in features.
"""

import numpy as np

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled, compiled_inline

LACUNARITY, PERSISTENCE = 2.03, 0.6
"""Factors on frequency and amplitude from one octave of the fractal to the next."""
Bits = np.uint64

CREASE_SCALES = (1.0, 0.37, 0.15)
"""Sizes of the flat pieces of crumpled foil, relative to the largest."""
CREASE_TILTS = (1.0, 0.75, 0.55)
"""Their tilts."""


@compiled_inline
def hash_bits(i: int, j: int, k: int, seed: int) -> Bits:
    """Lattice point and seed -> 64 random bits."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    h ^= np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    h ^= np.uint64(k) * np.uint64(0x165667B19E3779F9)
    h += np.uint64(seed) * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return h ^ (h >> np.uint64(32))


@compiled_inline
def unit_interval(bits: Bits, place: int) -> float:
    """The first, second or third 21 bits (0, 1, 2) as a number in [0, 1)."""
    # Signed integers are converted to floats by one instruction, unsigned ones are not.
    return np.int64((bits >> np.uint64(21 * place)) & np.uint64(0x1FFFFF)) / 2097152.0


@compiled_inline
def _rehashed(bits: Bits) -> Bits:
    """Other random bits of the same cell."""
    h = bits * np.uint64(0x9E3779B97F4A7C15)
    return h ^ (h >> np.uint64(32))


@compiled
def _value_noise(x: float, y: float, z: float, seed: int) -> tuple[float, float, float, float]:
    """Smooth noise in [-1, 1], feature size 1, and its gradient."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    fx, fy, fz = x - i, y - j, z - k
    u = fx * fx * fx * (fx * (fx * 6.0 - 15.0) + 10.0)
    v = fy * fy * fy * (fy * (fy * 6.0 - 15.0) + 10.0)
    w = fz * fz * fz * (fz * (fz * 6.0 - 15.0) + 10.0)
    du = 30.0 * fx * fx * (fx - 1.0) * (fx - 1.0)
    dv = 30.0 * fy * fy * (fy - 1.0) * (fy - 1.0)
    dw = 30.0 * fz * fz * (fz - 1.0) * (fz - 1.0)
    value, gx, gy, gz = 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        wa, da = (u, du) if a else (1.0 - u, -du)
        for b in range(2):
            wb, db = (v, dv) if b else (1.0 - v, -dv)
            for c in range(2):
                wc, dc = (w, dw) if c else (1.0 - w, -dw)
                corner = 2.0 * unit_interval(hash_bits(i + a, j + b, k + c, seed), 0) - 1.0
                value += wa * wb * wc * corner
                gx += da * wb * wc * corner
                gy += wa * db * wc * corner
                gz += wa * wb * dc * corner
    return value, gx, gy, gz


@compiled
def fractal_at(x: float, y: float, z: float, octaves: int, seed: int) -> tuple[float, float, float, float]:
    """Sum of octaves in [-1, 1] whose largest feature has size 1, and its gradient."""
    size, amplitude, norm = 1.0, 1.0, 0.0
    value, gx, gy, gz = 0.0, 0.0, 0.0, 0.0
    for octave in range(octaves):
        shift = 17.31 * octave
        own, dx, dy, dz = _value_noise(
            x * size + shift, y * size - shift, z * size + 0.5 * shift, seed + octave
        )
        value += amplitude * own
        gx += amplitude * size * dx
        gy += amplitude * size * dy
        gz += amplitude * size * dz
        norm += amplitude
        size *= LACUNARITY
        amplitude *= PERSISTENCE
    return value / norm, gx / norm, gy / norm, gz / norm


@compiled
def nearest_cell_at(x: float, y: float, z: float, seed: int) -> Bits:
    """Random bits of the nearest of random points, one in each unit cube."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w = x - i, y - j, z - k
    best, answer = 1e9, np.uint64(0)
    # The near side comes first: a close point makes most of the far cubes unnecessary.
    side_x, side_y, side_z = (1 if u > 0.5 else -1), (1 if v > 0.5 else -1), (1 if w > 0.5 else -1)
    for at_x in range(3):
        a = (0, side_x, -side_x)[at_x]
        reach_x = (u if a < 0 else 1.0 - u) if a else 0.0
        if reach_x * reach_x >= best:
            break
        for at_y in range(3):
            b = (0, side_y, -side_y)[at_y]
            reach_y = (v if b < 0 else 1.0 - v) if b else 0.0
            if reach_x * reach_x + reach_y * reach_y >= best:
                break
            for at_z in range(3):
                c = (0, side_z, -side_z)[at_z]
                reach_z = (w if c < 0 else 1.0 - w) if c else 0.0
                if reach_x * reach_x + reach_y * reach_y + reach_z * reach_z >= best:
                    break
                bits = hash_bits(i + a, j + b, k + c, seed)
                dx = a + unit_interval(bits, 0) - u
                dy = b + unit_interval(bits, 1) - v
                dz = c + unit_interval(bits, 2) - w
                distance = dx * dx + dy * dy + dz * dz
                if distance < best:
                    best, answer = distance, bits
    return answer


@compiled
def cell_at(x: float, y: float, z: float, seed: int) -> float:
    """One uniform value in [-1, 1] per random cell of size 1."""
    return 2.0 * unit_interval(_rehashed(nearest_cell_at(x, y, z, seed)), 0) - 1.0


@compiled
def creases_at(x: float, y: float, z: float, seed: int) -> tuple[float, float, float]:
    """Tilt of crumpled foil with flat pieces up to size 1: constant on each piece, cells within cells."""
    tx, ty, tz = 0.0, 0.0, 0.0
    for level in range(3):
        s = 1.0 / CREASE_SCALES[level]
        bits = nearest_cell_at(x * s, y * s, z * s, seed + 7 * level)
        own = _rehashed(bits)
        amplitude = 2.0 * CREASE_TILTS[level]
        tx += amplitude * (unit_interval(own, 0) - 0.5)
        ty += amplitude * (unit_interval(own, 1) - 0.5)
        tz += amplitude * (unit_interval(own, 2) - 0.5)
    return tx, ty, tz


@compiled
def _fractal(p: Array, scale_m: Array, octaves: int, seed: Ints) -> Array:
    out = np.empty(len(p))
    for n in range(len(p)):
        s = 1.0 / scale_m[n]
        out[n] = fractal_at(p[n, 0] * s, p[n, 1] * s, p[n, 2] * s, octaves, seed[n])[0]
    return out


def fractal(p_G: Array, scale_m: Array, seed: Ints, octaves: int = 5) -> Array:
    """Fractal noise in [-1, 1] at points (n, 3) [m]; largest feature scale_m (n,) [m], integer seed (n,)."""
    return np.asarray(_fractal(np.ascontiguousarray(p_G), scale_m, octaves, seed))
