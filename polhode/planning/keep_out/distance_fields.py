"""Compiled loops over grids of distances: nearest points, the volume that a moving body sweeps, protrusions.

The point nearest to a cell is nearly always that of one of its neighbours: sweeps along the eight diagonals
pass candidates from cell to cell, as in fast sweeping (Zhao, Math. Comp. 74, 2005).

A cell of the swept volume contains, for each of several factors c, the minimum over time of
``distance - c sigma``: distance to the body's surface, sigma of that surface along the direction to the cell,
from the covariance of the pose.
"""

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled_ieee

ROUNDS = 2
"""Of eight sweeps each."""


def closest(origin: Array, step_m: float, shape: tuple[int, int, int], q: Array, radius: Array) -> Ints:
    """Index (nx, ny, nz) of the point (m, 3) with the smallest distance minus radius (m,)."""
    best = np.full(shape, -1, dtype=np.int64)
    value = np.full(shape, np.inf)
    place = np.ascontiguousarray((q - origin) / step_m)
    reach = np.ascontiguousarray(radius / step_m)
    _seed(best, value, place, reach)
    for _ in range(ROUNDS):
        for i in (1, -1):
            for j in (1, -1):
                for k in (1, -1):
                    _sweep(best, value, place, reach, i, j, k)
    return best


@compiled_ieee
def _seed(best: Ints, value: Array, place: Array, reach: Array) -> None:
    nx, ny, nz = best.shape
    for n in range(len(place)):
        a, b, c = int(place[n, 0]), int(place[n, 1]), int(place[n, 2])
        for i in range(max(a, 0), min(a + 2, nx)):
            for j in range(max(b, 0), min(b + 2, ny)):
                for k in range(max(c, 0), min(c + 2, nz)):
                    away = (place[n, 0] - i) ** 2 + (place[n, 1] - j) ** 2 + (place[n, 2] - k) ** 2
                    found = np.sqrt(away) - reach[n]
                    if found < value[i, j, k]:
                        value[i, j, k] = found
                        best[i, j, k] = n


@compiled_ieee
def _sweep(best: Ints, value: Array, place: Array, reach: Array, si: int, sj: int, sk: int) -> None:
    nx, ny, nz = best.shape
    for x in range(nx):
        i = x if si > 0 else nx - 1 - x
        for y in range(ny):
            j = y if sj > 0 else ny - 1 - y
            for z in range(nz):
                k = z if sk > 0 else nz - 1 - z
                for which in range(1, 8):
                    a = i - si * (which & 1)
                    b = j - sj * ((which >> 1) & 1)
                    c = k - sk * (which >> 2)
                    if a < 0 or a >= nx or b < 0 or b >= ny or c < 0 or c >= nz:
                        continue
                    n = best[a, b, c]
                    if n < 0 or n == best[i, j, k]:
                        continue
                    away = (place[n, 0] - i) ** 2 + (place[n, 1] - j) ** 2 + (place[n, 2] - k) ** 2
                    found = np.sqrt(away) - reach[n]
                    if found < value[i, j, k]:
                        value[i, j, k] = found
                        best[i, j, k] = n


Floats = NDArray[np.float32]
FAR = 1e3
"""[m] of a cell that the body does not approach"""
DEEP_CELLS = 2.0
"""A cell this far inside is not updated."""
REACH_CELLS = 3.0


@compiled_ieee
def linear(values: Floats, origin: Array, step: float, x: float, y: float, z: float, out: Array) -> None:
    """out (4,): value at a point and its gradient; outside the grid a lower bound of a distance.

    With x0 the nearest point of the border the distance is at least sqrt(|x - x0|^2 + value(x0)^2).
    """
    nx, ny, nz = values.shape
    a, b, c = (x - origin[0]) / step, (y - origin[1]) / step, (z - origin[2]) / step
    u, v, w = min(max(a, 0.0), nx - 1.0), min(max(b, 0.0), ny - 1.0), min(max(c, 0.0), nz - 1.0)
    i, j, k = min(int(u), nx - 2), min(int(v), ny - 2), min(int(w), nz - 2)
    off = (a - u) * step, (b - v) * step, (c - w) * step
    u, v, w = u - i, v - j, w - k
    v000, v001 = values[i, j, k], values[i, j, k + 1]
    v010, v011 = values[i, j + 1, k], values[i, j + 1, k + 1]
    v100, v101 = values[i + 1, j, k], values[i + 1, j, k + 1]
    v110, v111 = values[i + 1, j + 1, k], values[i + 1, j + 1, k + 1]
    c00, c01 = v000 + (v001 - v000) * w, v010 + (v011 - v010) * w
    c10, c11 = v100 + (v101 - v100) * w, v110 + (v111 - v110) * w
    low, high = c00 + (c01 - c00) * v, c10 + (c11 - c10) * v
    out[0] = low + (high - low) * u
    out[1] = (high - low) / step
    out[2] = ((c01 - c00) * (1.0 - u) + (c11 - c10) * u) / step
    back = (v001 - v000) * (1.0 - v) + (v011 - v010) * v
    front = (v101 - v100) * (1.0 - v) + (v111 - v110) * v
    out[3] = (back * (1.0 - u) + front * u) / step
    away = off[0] ** 2 + off[1] ** 2 + off[2] ** 2
    size = np.sqrt(out[1] ** 2 + out[2] ** 2 + out[3] ** 2)
    if away > 0.0 and size > 1e-6:
        value = max(out[0], 0.0)
        whole = np.sqrt(away + value**2)
        for axis in range(3):
            out[1 + axis] = (off[axis] + value * out[1 + axis] / size) / whole
        out[0] = whole


@compiled_ieee
def values_at(values: Floats, origin: Array, step: float, points: Array) -> Array:
    """Of a grid at points (n, 3), linear in between; outside as in ``linear``."""
    out, found = np.empty(len(points)), np.empty(4)
    for n in range(len(points)):
        linear(values, origin, step, points[n, 0], points[n, 1], points[n, 2], found)
        out[n] = found[0]
    return out


@compiled_ieee
def sigma_along(P: Array, x: float, y: float, z: float, found: Array) -> float:
    """Sigma of the surface nearest to a point in G, along the direction to it; found (4,) of ``linear``."""
    size = np.sqrt(found[1] ** 2 + found[2] ** 2 + found[3] ** 2)
    if size < 1e-6:
        return float(np.sqrt(P[0, 0] + P[1, 1] + P[2, 2]))
    nx, ny, nz = found[1] / size, found[2] / size, found[3] / size
    qx, qy, qz = x - found[0] * nx, y - found[0] * ny, z - found[0] * nz
    a = (nx, ny, nz, qy * nz - qz * ny, qz * nx - qx * nz, qx * ny - qy * nx)
    total = 0.0
    for i in range(6):
        for j in range(6):
            total += a[i] * P[i, j] * a[j]
    return float(np.sqrt(max(total, 0.0)))


@compiled_ieee
def sweep(
    fields: Floats,
    origin: Array,
    step: float,
    factors: Array,
    R: Array,
    p: Array,
    P: Array,
    reach_m: Array,
    body: Floats,
    body_origin: Array,
    body_step: float,
    middle: Array,
    radius: float,
) -> None:
    """Lower fields (nx, ny, nz, C) by the body at T instants: R (T, 3, 3), p (T, 3), P (T, 6, 6).

    factors (C,) ascending from 0; reach_m (T,): distance from the body within which the fields must be valid.
    """
    nx, ny, nz, C = fields.shape
    found = np.empty(4)
    shift = np.sqrt(P[:, 0, 0] + P[:, 1, 1] + P[:, 2, 2])
    turn = np.sqrt(P[:, 3, 3] + P[:, 4, 4] + P[:, 5, 5])
    for t in range(len(R)):
        A = R[t]
        cx = A[0, 0] * middle[0] + A[0, 1] * middle[1] + A[0, 2] * middle[2] + p[t, 0]
        cy = A[1, 0] * middle[0] + A[1, 1] * middle[1] + A[1, 2] * middle[2] + p[t, 1]
        cz = A[2, 0] * middle[0] + A[2, 1] * middle[1] + A[2, 2] * middle[2] + p[t, 2]
        far = radius + reach_m[t] + REACH_CELLS * step
        i0, i1 = max(0, int((cx - far - origin[0]) / step)), min(nx, int((cx + far - origin[0]) / step) + 2)
        j0, j1 = max(0, int((cy - far - origin[1]) / step)), min(ny, int((cy + far - origin[1]) / step) + 2)
        k0, k1 = max(0, int((cz - far - origin[2]) / step)), min(nz, int((cz + far - origin[2]) / step) + 2)
        for i in range(i0, i1):
            x = origin[0] + i * step
            for j in range(j0, j1):
                y = origin[1] + j * step
                flat = (x - cx) ** 2 + (y - cy) ** 2
                if flat > far * far:
                    continue
                for k in range(k0, k1):
                    if fields[i, j, k, 0] < -DEEP_CELLS * step:
                        continue
                    z = origin[2] + k * step
                    if flat + (z - cz) ** 2 > far * far:
                        continue
                    dx, dy, dz = x - p[t, 0], y - p[t, 1], z - p[t, 2]
                    gx = A[0, 0] * dx + A[1, 0] * dy + A[2, 0] * dz
                    gy = A[0, 1] * dx + A[1, 1] * dy + A[2, 1] * dz
                    gz = A[0, 2] * dx + A[1, 2] * dy + A[2, 2] * dz
                    linear(body, body_origin, body_step, gx, gy, gz, found)
                    if found[0] > reach_m[t] + REACH_CELLS * step + fields[i, j, k, 0]:
                        continue
                    # an upper bound of sigma: where it lowers no field, sigma does not either
                    lever = np.sqrt(gx * gx + gy * gy + gz * gz) + abs(found[0])
                    most = 1.000001 * (shift[t] + lever * turn[t])
                    lower = False
                    for c in range(C):
                        lower = lower or found[0] - factors[c] * most < fields[i, j, k, c]
                    if not lower:
                        continue
                    sigma = sigma_along(P[t], gx, gy, gz, found)
                    for c in range(C):
                        value = found[0] - factors[c] * sigma
                        if value < fields[i, j, k, c]:
                            fields[i, j, k, c] = value


@compiled_ieee
def protrusion(
    fields: Floats, origin: Array, step: float, R: Array, p: Array, pairs: Ints, points: Array
) -> Array:
    """Protrusion of members (n, C) [m]: the largest value of each field at any of their points.

    R (n, T, 3, 3), p (n, T, 3); pairs (k, 2): instant, and which of the points (m, 3) in G.
    """
    nx, ny, nz, C = fields.shape
    out = np.full((len(R), C), -FAR)
    for n in range(len(R)):
        for one in range(len(pairs)):
            t, m = pairs[one, 0], pairs[one, 1]
            A, g = R[n, t], points[m]
            a = (A[0, 0] * g[0] + A[0, 1] * g[1] + A[0, 2] * g[2] + p[n, t, 0] - origin[0]) / step
            b = (A[1, 0] * g[0] + A[1, 1] * g[1] + A[1, 2] * g[2] + p[n, t, 1] - origin[1]) / step
            c = (A[2, 0] * g[0] + A[2, 1] * g[1] + A[2, 2] * g[2] + p[n, t, 2] - origin[2]) / step
            u, v, w = min(max(a, 0.0), nx - 1.0), min(max(b, 0.0), ny - 1.0), min(max(c, 0.0), nz - 1.0)
            i, j, k = min(int(u), nx - 2), min(int(v), ny - 2), min(int(w), nz - 2)
            away = np.sqrt((a - u) ** 2 + (b - v) ** 2 + (c - w) ** 2) * step
            u, v, w = u - i, v - j, w - k
            a0, a1, b0, b1 = (1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v
            for f in range(C):
                value = a0 * (fields[i, j, k, f] * (1 - w) + fields[i, j, k + 1, f] * w)
                value += a1 * (fields[i, j + 1, k, f] * (1 - w) + fields[i, j + 1, k + 1, f] * w)
                value += b0 * (fields[i + 1, j, k, f] * (1 - w) + fields[i + 1, j, k + 1, f] * w)
                value += b1 * (fields[i + 1, j + 1, k, f] * (1 - w) + fields[i + 1, j + 1, k + 1, f] * w)
                out[n, f] = max(out[n, f], value + away)
    return out


@compiled_ieee
def protrusion_at_instants(
    factors: Array,
    R: Array,
    p: Array,
    R_nominal: Array,
    p_nominal: Array,
    P: Array,
    body: Floats,
    body_origin: Array,
    body_step: float,
    points: Array,
) -> Array:
    """Protrusion of members from the body at the same instant (n, C) [m], minus c sigma."""
    out = np.full((len(R), len(factors)), -FAR)
    found = np.empty(4)
    for n in range(len(R)):
        for t in range(len(R_nominal)):
            turn = R_nominal[t].T @ R[n, t]
            shift = R_nominal[t].T @ (p[n, t] - p_nominal[t])
            for m in range(len(points)):
                g = points[m]
                x = turn[0, 0] * g[0] + turn[0, 1] * g[1] + turn[0, 2] * g[2] + shift[0]
                y = turn[1, 0] * g[0] + turn[1, 1] * g[1] + turn[1, 2] * g[2] + shift[1]
                z = turn[2, 0] * g[0] + turn[2, 1] * g[1] + turn[2, 2] * g[2] + shift[2]
                linear(body, body_origin, body_step, x, y, z, found)
                if found[0] < out[n, len(factors) - 1]:
                    continue
                sigma = sigma_along(P[t], x, y, z, found)
                for c in range(len(factors)):
                    out[n, c] = max(out[n, c], found[0] - factors[c] * sigma)
    return out
