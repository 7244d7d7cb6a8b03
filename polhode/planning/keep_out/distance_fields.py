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


def closest(origin: Array, step_m: float, shape: tuple[int, int, int], q: Array, radius: Array) -> Ints:
    """Index (nx, ny, nz) of the point (m, 3) with the smallest distance minus radius (m,).

    A second round of sweeps would change one cell of a thousand, by a tenth of a cell.
    """
    best = np.full(shape, -1, dtype=np.int64)
    value = np.full(shape, np.inf)
    place = np.ascontiguousarray((q - origin) / step_m)
    reach = np.ascontiguousarray(radius / step_m)
    _seed(best, value, place, reach)
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
"""[m] of what is nowhere"""
TOLERANCE_CELLS = 0.15
"""By so much less a field may be lowered than it could be."""
SLOWER = 0.9
"""Interpolated distances may change a little faster than true ones."""
DEEP_CELLS = 4.0
"""A cell this far inside is not updated."""


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
def grown_distances(
    values: Floats, origin: Array, step: float, p_G: Array, P: Array
) -> tuple[Array, Array, Array]:
    """Distance (n,) of points (n, 3) in G from the body, sigma (n,) of the pose, P (n, 6, 6), along it, and
    unit vectors (n, 3) away from the body.
    """
    n = len(p_G)
    distance, sigma, gradient, found = np.empty(n), np.empty(n), np.zeros((n, 3)), np.empty(4)
    for m in range(n):
        linear(values, origin, step, p_G[m, 0], p_G[m, 1], p_G[m, 2], found)
        distance[m], sigma[m] = found[0], sigma_along(P[m], p_G[m, 0], p_G[m, 1], p_G[m, 2], found)
        size = np.sqrt(found[1] ** 2 + found[2] ** 2 + found[3] ** 2)
        if size > 1e-9:
            gradient[m] = found[1:] / size
    return distance, sigma, gradient


@compiled_ieee
def nearest_with_sigma(points: Array, P: Array, p_G: Array, factor: float) -> tuple[Array, Array]:
    """The least of distance minus c sigma (n,) of places (n, 3) from a body's points (m, 3), and the unit
    vectors (n, 3) away from that point.

    A point that is farther away than another may come nearest, by its sigma along the line to
    the place; P (n, 6, 6).
    """
    least, away, arm = np.full(len(p_G), np.inf), np.zeros((len(p_G), 3)), np.empty(6)
    for n in range(len(p_G)):
        for m in range(len(points)):
            q = points[m]
            line = p_G[n] - q
            distance = np.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2)
            u = line / max(distance, 1e-12)
            arm[:3] = u
            arm[3], arm[4] = q[1] * u[2] - q[2] * u[1], q[2] * u[0] - q[0] * u[2]
            arm[5] = q[0] * u[1] - q[1] * u[0]
            variance = 0.0
            for i in range(6):
                for j in range(6):
                    variance += arm[i] * P[n, i, j] * arm[j]
            value = distance - factor * np.sqrt(max(variance, 0.0))
            if value < least[n]:
                least[n], away[n] = value, u
    return least, away


@compiled_ieee
def reasons_of(
    places: Array, R: Array, p: Array, values: Floats, origin: Array, step: float, reason: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], Array]:
    """What the body nearest to places (n, 3) in N is known by, at the nearest of T instants, and its distance
    (n,) there; R (T, 3, 3), p (T, 3); reason: of each corner of the body's grid.
    """
    nx, ny, nz = values.shape
    out, least, found = np.zeros(len(places), dtype=np.uint8), np.full(len(places), np.inf), np.empty(4)
    for n in range(len(places)):
        for t in range(len(R)):
            dx, dy, dz = places[n, 0] - p[t, 0], places[n, 1] - p[t, 1], places[n, 2] - p[t, 2]
            x = R[t, 0, 0] * dx + R[t, 1, 0] * dy + R[t, 2, 0] * dz
            y = R[t, 0, 1] * dx + R[t, 1, 1] * dy + R[t, 2, 1] * dz
            z = R[t, 0, 2] * dx + R[t, 1, 2] * dy + R[t, 2, 2] * dz
            linear(values, origin, step, x, y, z, found)
            if found[0] < least[n]:
                least[n] = found[0]
                # of the body's surface nearest to the place
                size = max(np.sqrt(found[1] ** 2 + found[2] ** 2 + found[3] ** 2), 1e-9)
                x -= found[0] * found[1] / size
                y -= found[0] * found[2] / size
                z -= found[0] * found[3] / size
                i = min(max(int(np.rint((x - origin[0]) / step)), 0), nx - 1)
                j = min(max(int(np.rint((y - origin[1]) / step)), 0), ny - 1)
                k = min(max(int(np.rint((z - origin[2]) / step)), 0), nz - 1)
                out[n] = reason[i, j, k]
    return out, least


@compiled_ieee
def nearest_approach(R: Array, p: Array, place: Array, values: Floats, origin: Array, step: float) -> Array:
    """The least distance [m] of points (T, m, 3) in N from the body at poses R (n, T, 3, 3), p (n, T, 3): of
    each member and instant (n, T).
    """
    out, found = np.full(p.shape[:2], np.inf), np.empty(4)
    for n in range(len(R)):
        for t in range(R.shape[1]):
            for m in range(place.shape[1]):
                dx, dy, dz = (
                    place[t, m, 0] - p[n, t, 0],
                    place[t, m, 1] - p[n, t, 1],
                    place[t, m, 2] - p[n, t, 2],
                )
                x = R[n, t, 0, 0] * dx + R[n, t, 1, 0] * dy + R[n, t, 2, 0] * dz
                y = R[n, t, 0, 1] * dx + R[n, t, 1, 1] * dy + R[n, t, 2, 1] * dz
                z = R[n, t, 0, 2] * dx + R[n, t, 1, 2] * dy + R[n, t, 2, 2] * dz
                linear(values, origin, step, x, y, z, found)
                out[n, t] = min(out[n, t], found[0])
    return out


@compiled_ieee
def sweep(
    fields: Floats,
    origin: Array,
    step: float,
    factors: Array,
    R: Array,
    p: Array,
    P: Array,
    body: Floats,
    body_origin: Array,
    body_step: float,
    middle: Array,
    radius: float,
) -> None:
    """Lower fields (nx, ny, nz, C) by the body at T instants: R (T, 3, 3), p (T, 3), P (T, 6, 6).

    factors (C,) ascending from 0. However far it turns, the body stays in its sphere (radius) about a point
    (3,) in G, which has a sigma of its own: nothing beyond that sphere, grown by c of those, is lowered.
    The distance of a cell from the body changes no faster than the body moves there: instants by which it
    cannot have come nearer than it was are left out.
    """
    nx, ny, nz, C = fields.shape
    T, found, tolerance = len(R), np.empty(4), TOLERANCE_CELLS * step
    # the largest sigmas up to each instant, and the largest motion between two instants
    shift, turn, across = np.zeros(T), np.zeros(T), np.zeros(T)
    centre, shifted, turned, of_middle = np.empty((T, 3)), 1e-12, 1e-12, np.zeros((T, 3, 3))
    arm = np.zeros((3, 6))
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        arm[axis, axis], arm[a, 3 + b], arm[b, 3 + a] = 1.0, middle[axis], -middle[axis]
    for t in range(T):
        before = max(t - 1, 0)
        centre[t] = R[t] @ middle + p[t]
        rotated = R[t] @ arm
        of_middle[t] = rotated @ P[t] @ rotated.T
        shift[t] = max(shift[before], _largest_sigma(P[t, :3, :3]))
        turn[t] = max(turn[before], _largest_sigma(P[t, 3:, 3:]))
        across[t] = max(across[before], _largest_sigma(of_middle[t]))
        if t > 0:
            shifted = max(shifted, np.sqrt(np.sum((centre[t] - centre[t - 1]) ** 2)))
            # the chord of the angle is at least this part of its arc, for steps below a radian
            turned = max(turned, 1.05 * np.sqrt(0.5 * np.sum((R[t] - R[t - 1]) ** 2)))
    for i in range(nx):
        for j in range(ny):
            # the instant that was the nearest to a cell is near to the next one, too
            hint = 0
            for k in range(nz):
                cell = fields[i, j, k]
                x, y, z = origin[0] + i * step, origin[1] + j * step, origin[2] + k * step
                t = T
                # backwards, as what has grown most lowers most: no earlier sigma is larger
                while t >= 0 and cell[0] > -DEEP_CELLS * step:
                    at = hint if t == T else t
                    a, b, c = x - centre[at, 0], y - centre[at, 1], z - centre[at, 2]
                    away = np.sqrt(a * a + b * b + c * c)
                    # by the sphere first, as that costs least
                    gap = np.inf
                    for n in range(C):
                        gap = min(gap, away - radius - factors[n] * across[at] - cell[n])
                    lever, speed = 0.0, shifted
                    if gap < 0.0:
                        least = cell[0]
                        lever, gap = _lower(
                            cell, factors, x - p[at, 0], y - p[at, 1], z - p[at, 2], R[at], P[at],
                            body, body_origin, body_step, a, b, c, away, of_middle[at], radius,
                            shift[at], turn[at], found,
                        )  # fmt: skip
                        speed += turned * (away + max(gap + tolerance, 0.0))
                        if cell[0] < least:
                            hint = at
                    gap += tolerance
                    steps = 1
                    if gap > speed:
                        grown = 2.0 * gap * turn[at] if lever > 0.0 else 0.0
                        steps = max(1, int(SLOWER * (gap - factors[C - 1] * grown) / speed))
                    t = T - 1 if t == T else t - steps


@compiled_ieee
def _largest_sigma(P: Array) -> float:
    return float(1.000001 * np.sqrt(max(np.linalg.eigvalsh(P)[-1], 0.0)))


@compiled_ieee
def _lower(
    cell: Floats,
    factors: Array,
    dx: float,
    dy: float,
    dz: float,
    R: Array,
    P: Array,
    body: Floats,
    body_origin: Array,
    body_step: float,
    ax: float,
    ay: float,
    az: float,
    away: float,
    of_middle: Array,
    radius: float,
    shift: float,
    turn: float,
    found: Array,
) -> tuple[float, float]:
    """Lower a cell's values (C,) by the body at one instant; its lever, and how far at least the body is from
    lowering one of them further.
    """
    C = len(factors)
    gx = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
    gy = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
    gz = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    linear(body, body_origin, body_step, gx, gy, gz, found)
    distance = found[0]
    lever = np.sqrt(gx * gx + gy * gy + gz * gz) + abs(distance)
    # an upper bound of sigma: where it lowers no field, sigma does not either
    sigma = shift + lever * turn
    lowers = False
    for c in range(C):
        lowers = lowers or distance - factors[c] * sigma < cell[c]
    if lowers:
        along = sigma_along(P, gx, gy, gz, found)
        M = of_middle
        across = ax * (M[0, 0] * ax + M[0, 1] * ay + M[0, 2] * az)
        across += ay * (M[1, 0] * ax + M[1, 1] * ay + M[1, 2] * az)
        across += az * (M[2, 0] * ax + M[2, 1] * ay + M[2, 2] * az)
        across = np.sqrt(max(across, 0.0)) / max(away, 1e-12)
        for c in range(C):
            value = max(distance - factors[c] * along, away - radius - factors[c] * across)
            cell[c] = min(cell[c], value)
    gap = np.inf
    for c in range(C):
        gap = min(gap, distance - factors[c] * sigma - cell[c])
    return lever, gap


@compiled_ieee
def outermost_pairs(
    field: Floats, origin: Array, step: float, R: Array, p: Array, points: Array, band_m: Array, parts: int
) -> Ints:
    """Pairs (k, 2) of instant and point, which is within the band (T,) of the surface of a swept volume.

    Of each cell and part of the horizon the one that protrudes most: R (T, 3, 3), p (T, 3), points (m, 3).
    """
    nx, ny, nz = field.shape
    best = np.full((nx, ny, nz, parts), -np.inf, dtype=np.float32)
    pair = np.zeros((nx, ny, nz, parts), dtype=np.int32)
    found, count = np.empty(4), 0
    for t in range(len(R)):
        A = R[t]
        for m in range(len(points)):
            g = points[m]
            x = A[0, 0] * g[0] + A[0, 1] * g[1] + A[0, 2] * g[2] + p[t, 0]
            y = A[1, 0] * g[0] + A[1, 1] * g[1] + A[1, 2] * g[2] + p[t, 1]
            z = A[2, 0] * g[0] + A[2, 1] * g[1] + A[2, 2] * g[2] + p[t, 2]
            i = min(max(int((x - origin[0]) / step), 0), nx - 1)
            j = min(max(int((y - origin[1]) / step), 0), ny - 1)
            k = min(max(int((z - origin[2]) / step), 0), nz - 1)
            if field[i, j, k] < -band_m[t] - 2.0 * step:
                continue
            linear(field, origin, step, x, y, z, found)
            part = t * parts // len(R)
            if found[0] > -band_m[t] and found[0] > best[i, j, k, part]:
                count += best[i, j, k, part] == -np.inf
                best[i, j, k, part] = found[0]
                pair[i, j, k, part] = t * len(points) + m
    out, n = np.empty((count, 2), dtype=np.int64), 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                for part in range(parts):
                    if best[i, j, k, part] > -np.inf:
                        out[n, 0] = pair[i, j, k, part] // len(points)
                        out[n, 1] = pair[i, j, k, part] % len(points)
                        n += 1
    return out


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
