"""Looking up the drawings of a body at hit points: all charts in one buffer, bilinear."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from polhode.lie import Array
from polhode.records import Ints
from simulation.bodies.part import Chart


class ChartAtlas:
    """The charts of a body, packed."""

    def __init__(self, charts: tuple[Chart, ...]) -> None:
        sizes = np.array([chart.image.size for chart in charts], dtype=np.int64)
        self._start = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])
        self._shape = np.array([chart.image.shape for chart in charts], dtype=np.int64).reshape(-1, 2)
        self._texels = np.concatenate([np.zeros(0, np.float32), *(chart.image.ravel() for chart in charts)])
        rows = [(c.origin_G, c.right_G / c.texel_m, c.down_G / c.texel_m) for c in charts]
        self._planes = np.array(rows, dtype=np.float64).reshape(-1, 3, 3)

    def reflectance(self, chart: Ints, p_G: Array) -> Array:
        """Drawn reflectance (n,) at points (n, 3) of charts (n,); NaN where chart is -1."""
        return np.asarray(_look_up(chart, p_G, self._start, self._shape, self._texels, self._planes))


@njit(cache=True)
def _look_up(
    chart: Ints,
    p: Array,
    start: Ints,
    shape: Ints,
    texels: NDArray[np.float32],
    planes: Array,
) -> Array:
    out = np.full(len(chart), np.nan)
    for n in range(len(chart)):
        c = chart[n]
        if c < 0:
            continue
        u, v = 0.0, 0.0
        for k in range(3):
            d = p[n, k] - planes[c, 0, k]
            u += d * planes[c, 1, k]
            v += d * planes[c, 2, k]
        height, width = shape[c]
        u = min(max(u, 0.0), width - 1.001)
        v = min(max(v, 0.0), height - 1.001)
        i, j = int(v), int(u)
        a, b = v - i, u - j
        at = start[c] + i * width + j
        top = (1 - b) * texels[at] + b * texels[at + 1]
        bottom = (1 - b) * texels[at + width] + b * texels[at + width + 1]
        out[n] = (1 - a) * top + a * bottom
    return out
