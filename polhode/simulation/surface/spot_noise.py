"""Solid textures of the second generator: noise of random spots, and foil with straight folds.

It shares nothing with noise.py, so that one can serve for training and the other for testing. Spots: sparse
convolution, after Lewis, "Algorithms for solid noise synthesis", SIGGRAPH 1989. Folds: a sum of functions
that are piecewise linear along random directions, so that every crease is straight and the sheet is
continuous.
"""

import numpy as np

from polhode.runtime.compiled import compiled, compiled_inline

State = np.uint64

SPOT_SLOPE = 0.21
"""Scales the slopes of layered spots to those of the other generator's fractal."""

SPOTS_PER_CELL = 2
FOLDS = 7
"""Directions along which the foil is folded."""


@compiled_inline
def _next(state: State) -> State:
    """The next state of a linear congruential generator of 64 bits (Knuth's MMIX constants)."""
    return state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)


@compiled_inline
def _draw(state: State) -> float:
    """A number in [0, 1) of the state's upper bits."""
    return np.int64(state >> np.uint64(40)) / 16777216.0


@compiled_inline
def _start(i: int, j: int, k: int, seed: int) -> State:
    """The generator's first state in a cell, after three steps of mixing."""
    state = np.uint64(seed) + np.uint64(0x5851F42D)
    state = _next(state ^ np.uint64(i & 0x1FFFFF))
    state = _next(state ^ (np.uint64(j & 0x1FFFFF) << np.uint64(20)))
    state = _next(state ^ (np.uint64(k & 0x1FFFFF) << np.uint64(40)))
    return state ^ (state >> np.uint64(31))


@compiled
def spots_at(x: float, y: float, z: float, seed: int) -> tuple[float, float, float, float]:
    """Noise of about [-1, 1] and its gradient: soft spots of random sign, feature size 1."""
    # Spots extend half a cell: the eight cells around the nearest corner contain all that contribute.
    i, j, k = int(np.floor(x - 0.5)), int(np.floor(y - 0.5)), int(np.floor(z - 0.5))
    value, gx, gy, gz = 0.0, 0.0, 0.0, 0.0
    for cell in range(8):
        a, b, c = i + (cell & 1), j + ((cell >> 1) & 1), k + (cell >> 2)
        state = _start(a, b, c, seed)
        for _ in range(SPOTS_PER_CELL):
            state = _next(state)
            dx = x - a - _draw(state)
            state = _next(state)
            dy = y - b - _draw(state)
            state = _next(state)
            dz = z - c - _draw(state)
            state = _next(state)
            rest = 1.0 - 4.0 * (dx * dx + dy * dy + dz * dz)
            if rest > 0.0:
                weight = 2.0 * (2.0 * _draw(state) - 1.0)
                value += weight * rest * rest
                slope = -16.0 * weight * rest
                gx += slope * dx
                gy += slope * dy
                gz += slope * dz
    return value, gx, gy, gz


@compiled
def layered_spots_at(x: float, y: float, z: float, seed: int) -> tuple[float, float, float, float]:
    """Large, middle and small spots, feature sizes 1, 0.4 and 0.15."""
    value, gx, gy, gz = 0.0, 0.0, 0.0, 0.0
    for layer in range(3):
        s = (1.0, 2.5, 6.7)[layer]
        amplitude = (0.55, 0.45, 0.35)[layer]
        own, dx, dy, dz = spots_at(x * s, y * s, z * s, seed + 31 * layer)
        value += amplitude * own
        gx += amplitude * s * dx
        gy += amplitude * s * dy
        gz += amplitude * s * dz
    return value, gx, gy, gz


@compiled
def discs_at(x: float, y: float, z: float, seed: int) -> float:
    """Hard-edged balls of all sizes up to 1, each with one value in [-1, 1]; the last one is on top."""
    i, j, k = int(np.floor(x - 0.5)), int(np.floor(y - 0.5)), int(np.floor(z - 0.5))
    value, top = 0.0, -1.0
    for cell in range(8):
        a, b, c = i + (cell & 1), j + ((cell >> 1) & 1), k + (cell >> 2)
        state = _start(a, b, c, seed)
        for _ in range(6):
            state = _next(state)
            dx = x - a - _draw(state)
            state = _next(state)
            dy = y - b - _draw(state)
            state = _next(state)
            dz = z - c - _draw(state)
            state = _next(state)
            order = _draw(state)
            state = _next(state)
            # Areas of all sizes: radius^-3 between 0.25 and 0.5 (dead leaves).
            radius = 1.0 / np.sqrt(16.0 - 12.0 * _draw(state))
            if dx * dx + dy * dy + dz * dz < radius * radius and order > top:
                top = order
                state = _next(state)
                value = 2.0 * _draw(state) - 1.0
    return value


@compiled
def folds_at(x: float, y: float, z: float, seed: int) -> tuple[float, float, float]:
    """Tilt of folded foil: the sum of slopes that jump at random positions along random directions."""
    tx, ty, tz = 0.0, 0.0, 0.0
    for fold in range(FOLDS):
        state = _next(_start(fold, 5, 9, seed))
        height = 2.0 * _draw(state) - 1.0
        state = _next(state)
        angle = 2.0 * np.pi * _draw(state)
        around = np.sqrt(1.0 - height * height)
        nx, ny, nz = around * np.cos(angle), around * np.sin(angle), height
        period = 0.25 + 0.17 * fold
        along = (nx * x + ny * y + nz * z) / period
        place = int(np.floor(along))
        state = _next(_start(place, fold, 1, seed))
        crease = place + 0.15 + 0.7 * _draw(state)
        after = place if along > crease else place - 1
        state = _next(_start(after, fold, 2, seed))
        slope = 0.9 * (2.0 * _draw(state) - 1.0) * (0.5 + 0.13 * fold)
        tx += slope * nx
        ty += slope * ny
        tz += slope * nz
    return tx, ty, tz
