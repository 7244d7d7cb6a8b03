"""Nearest descriptors among the key points of the other image that lie on nearly the same row, compiled.

Key points of the right image are sorted by row, so that each of the left ones is compared with the few that
are near its own row, instead of with all.

Matches that ignore the epipolar constraint (``row_offsets``) check the rig, not the target: where rows differ
or disparities are negative, the calibration is wrong, the rig has moved in itself, the cameras look at
different times, or the images are exchanged.
"""

from dataclasses import dataclass

import numpy as np

from polhode.frontend.features.keypoints import Descriptors, KeyPoints, strongest
from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled_reordered

MAX_OCTAVES, MAX_TURN_RAD = 0.6, float(np.deg2rad(35.0))
"""Largest differences of scale and orientation between the two images of a point."""
STRONGEST = 300
"""Key points of each image that ``row_offsets`` compares, the strongest first."""
MAX_ROWS_PX = 5.0
"""Largest difference of rows of its matches: several times those of 0.2 degrees between the cameras."""
MAX_SHIFT_SHARE = 0.7
"""Largest distance of the two columns of a match, as a share of the image's width: at the depth that it
means, the rest of the width is what both cameras see. Of converging cameras this is not the disparity beyond
that of infinity, which may exceed the width."""


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
    first, second, first_left = np.full(n, -1.0), np.full(n, -1.0), np.full(m, -1.0)
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


@dataclass(frozen=True)
class RowOffsets:
    """n matches of one pair."""

    uv_px: Array
    """(n, 2) in the rectified left image"""
    disparity_px: Array
    """(n,) to the key point itself, of either sign"""
    offset_px: Array
    """(n,) row in the left image minus row in the right one"""


def row_offsets(
    left: KeyPoints, right: KeyPoints, width_px: int, max_rows_px: float = MAX_ROWS_PX
) -> RowOffsets:
    """Mutually best descriptors among the strongest key points of both images, whatever their rows' order.

    Both signs of the disparity are searched, so that points behind the cameras show. max_rows_px: largest
    difference of rows.
    """
    left, right = (strongest(points, STRONGEST) for points in (left, right))
    widest = MAX_SHIFT_SHARE * width_px
    gate_px = np.full(len(left), max_rows_px)
    kept, matched = mutual_nearest(left, right, gate_px, (-widest, widest), 0.8)
    offset = left.uv_px[kept] - right.uv_px[matched]
    return RowOffsets(left.uv_px[kept], offset[:, 0], offset[:, 1])
