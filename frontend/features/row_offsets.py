"""Left-to-right matches that ignore the epipolar constraint: what they show checks the rig, not the target.

Of a rectified pair, rows agree and disparities are positive. Where they do not, the calibration is wrong, the
rig has moved in itself, the cameras look at different times, or the images are exchanged. Features for the
estimate are matched within a narrow band of rows and cannot show it.
"""

from dataclasses import dataclass

import numpy as np

from polhode.frontend.features.epipolar_search import mutual_nearest
from polhode.frontend.features.keypoints import KeyPoints, strongest
from polhode.geometry.lie import Array

STRONGEST = 300
"""Key points of each image that are compared, the strongest first."""
MAX_ROWS_PX = 5.0
"""Largest difference of rows of a match: several times what 0.2 degrees between the cameras cause [px]."""
MAX_SHIFT_SHARE = 0.7
"""Largest distance of the columns of a match, as a share of the image's width."""
_RATIO = 0.8


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
    kept, matched = mutual_nearest(left, right, gate_px, (-widest, widest), _RATIO)
    offset = left.uv_px[kept] - right.uv_px[matched]
    return RowOffsets(left.uv_px[kept], offset[:, 0], offset[:, 1])
