"""Limits of motions whose answer is known, without an estimate."""

import numpy as np

from polhode.lie import Array
from polhode.pipeline.intervals.motion_limits import MotionLimits


def spin_limits(axis: int = 2, com_G: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> MotionLimits:
    """A steady spin about an axis of G: free is a shift along it; it is a principal axis."""
    margin = np.zeros(3)
    margin[axis] = 10.0
    rows = np.zeros((2, 6))
    # the products of inertia with this axis, among xy, xz, yz
    for row, product in zip(
        rows, [n for n, pair in enumerate(((0, 1), (0, 2), (1, 2))) if axis in pair], strict=True
    ):
        row[3 + product] = 1.0
    return MotionLimits(np.array(com_G), np.eye(3), margin, np.concatenate([rows, -rows]), np.eye(3))


def no_limits(com_G: Array | None = None) -> MotionLimits:
    """A target at rest: everything is free."""
    center = np.zeros(3) if com_G is None else com_G
    return MotionLimits(center, np.eye(3), np.full(3, 10.0), np.zeros((0, 6)), np.eye(3))
