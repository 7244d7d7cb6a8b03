"""Which of many points is the closest to each cell of a grid: candidates handed on from cell to cell.

The closest point of a cell is nearly always that of one of its neighbours: sweeps along the eight
diagonals, as in fast sweeping (Zhao, Math. Comp. 74, 2005). Points may have a radius; what counts is distance
less radius.
"""

import numpy as np

from polhode.compiled import compiled_ieee
from polhode.lie import Array
from polhode.records import Ints

ROUNDS = 2
"""Of eight sweeps each."""


def closest(origin: Array, step_m: float, shape: tuple[int, int, int], q: Array, radius: Array) -> Ints:
    """Index (nx, ny, nz) of the point (m, 3) whose distance less its radius (m,) is the least."""
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
