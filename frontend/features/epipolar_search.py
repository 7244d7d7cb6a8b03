"""Nearest descriptors among the key points of the other image that lie on nearly the same row, compiled.

Key points of the right image are sorted by row, so that each of the left ones is compared with the few that
are near its own row, instead of with all.
"""

import numpy as np

from polhode.frontend.features.keypoints import Descriptors, KeyPoints
from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled_reordered

MAX_OCTAVES, MAX_TURN_RAD = 0.6, float(np.deg2rad(35.0))
"""Largest differences of scale and orientation between the two images of a point."""
NONE = -1.0
"""Similarity where there is no candidate."""


def mutual_nearest(
    left: KeyPoints, right: KeyPoints, row_gate_px: Array, shifts_px: tuple[float, float], ratio: float
) -> tuple[Ints, Ints]:
    """Matches (m,), (m,) of key points that are each other's nearest among those with similar rows, scales
    and orientations.

    row_gate_px (n,): largest difference of rows; shifts_px: range of the columns' difference, left minus
    right, ends excluded; ratio: largest one of best to second best distance.
    """
    if len(left) == 0 or len(right) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    by_row = np.argsort(right.uv_px[:, 1], kind="stable")
    best, first, second, best_left = _search(
        _placed(left),
        _placed(right, by_row),
        np.ascontiguousarray(left.descriptors),
        right.descriptors[by_row],
        row_gate_px,
        shifts_px[0],
        shifts_px[1],
    )
    rows = np.flatnonzero(first > 0.0)
    rows = rows[best_left[best[rows]] == rows]
    distance, runner_up = (np.sqrt(np.maximum(2.0 - 2.0 * s[rows], 0.0)) for s in (first, second))
    kept = rows[distance < ratio * runner_up]
    return kept, by_row[best[kept]]


def _placed(points: KeyPoints, order: Ints | slice = slice(None)) -> Array:
    """(n, 4) column, row, octave and orientation."""
    return np.column_stack([points.uv_px, np.log2(points.scale_px), points.angle_rad])[order]


@compiled_reordered
def _search(
    left: Array,
    right: Array,
    descriptors_left: Descriptors,
    descriptors_right: Descriptors,
    row_gate_px: Array,
    least_px: float,
    largest_px: float,
) -> tuple[Ints, Array, Array, Ints]:
    """For each left point (n,) the nearest right one, its similarity and the second largest; for each right
    point (m,) the nearest left one."""
    n, m = len(left), len(right)
    best, best_left = np.full(n, -1), np.full(m, -1)
    first, second, first_left = np.full(n, NONE), np.full(n, NONE), np.full(m, NONE)
    for i in range(n):
        u, v, octave, angle = left[i]
        j = np.searchsorted(right[:, 1], v - row_gate_px[i], side="right")
        while j < m and right[j, 1] < v + row_gate_px[i]:
            shift = u - right[j, 0]
            turn = abs((angle - right[j, 3] + np.pi) % (2.0 * np.pi) - np.pi)
            if (
                least_px < shift < largest_px
                and abs(octave - right[j, 2]) < MAX_OCTAVES
                and turn < MAX_TURN_RAD
            ):
                alike = np.float32(0.0)
                for d in range(descriptors_left.shape[1]):
                    alike += descriptors_left[i, d] * descriptors_right[j, d]
                if alike > first[i]:
                    best[i], second[i], first[i] = j, first[i], alike
                elif alike > second[i]:
                    second[i] = alike
                if alike > first_left[j]:
                    best_left[j], first_left[j] = i, alike
            j += 1
    return best, first, second, best_left
