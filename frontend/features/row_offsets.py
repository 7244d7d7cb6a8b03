"""Left-to-right matches that ignore the epipolar constraint: what they show checks the rig, not the target.

Of a rectified pair, rows agree and disparities are positive. Where they do not, the calibration is wrong, the
rig has moved in itself, the cameras look at different times, or the images are exchanged. Features for the
estimate are matched within a narrow band of rows and cannot show it.
"""

from dataclasses import dataclass

import numpy as np

from polhode.frontend.features.keypoints import KeyPoints
from polhode.lie import Array

STRONGEST = 300
"""Key points of each image that are compared, the strongest first."""
MAX_ROWS_PX = 5.0
"""Largest difference of rows of a match: several times what 0.2 degrees between the cameras cause [px]."""
MAX_SHIFT_SHARE = 0.7
"""Largest distance of the columns of a match, as a share of the image's width."""
_RATIO = 0.8
_MAX_OCTAVES, _MAX_TURN_RAD = 0.6, np.deg2rad(35.0)


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
    n, m = (min(len(points), STRONGEST) for points in (left, right))
    if n == 0 or m == 0:
        return RowOffsets(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    offset = left.uv_px[:n, None, 1] - right.uv_px[None, :m, 1]
    disparity = left.uv_px[:n, None, 0] - right.uv_px[None, :m, 0]
    octave = np.abs(np.log2(left.scale_px[:n, None] / right.scale_px[None, :m]))
    turn = np.abs((left.angle_rad[:n, None] - right.angle_rad[None, :m] + np.pi) % (2 * np.pi) - np.pi)
    allowed = (np.abs(offset) < max_rows_px) & (octave < _MAX_OCTAVES) & (turn < _MAX_TURN_RAD)
    allowed &= np.abs(disparity) < MAX_SHIFT_SHARE * width_px
    similarity = np.where(allowed, left.descriptors[:n] @ right.descriptors[:m].T, -1.0)
    rows, best = np.arange(n), similarity.argmax(axis=1)
    mutual = similarity.argmax(axis=0)[best] == rows
    top = similarity[rows, best]
    similarity[rows, best] = -1.0
    distance, second = (np.sqrt(np.maximum(2.0 - 2.0 * s, 0.0)) for s in (top, similarity.max(axis=1)))
    kept = np.flatnonzero(mutual & (top > 0.0) & (distance < _RATIO * second))
    at = kept, best[kept]
    return RowOffsets(left.uv_px[kept], disparity[at], offset[at])
