"""Directions in words."""

import numpy as np

from polhode.lie import Array

_PART = 0.5
"""Share of its length that a direction must have along an axis for the axis to be named."""


def axis_words(direction: Array) -> str:
    """``+x``, or ``+x and -z`` where the direction (3,) lies between axes; the largest part first."""
    unit = np.asarray(direction) / max(float(np.linalg.norm(direction)), 1e-300)
    named = [k for k in np.argsort(-np.abs(unit), kind="stable") if abs(unit[k]) >= _PART]
    return " and ".join(f"{'+' if unit[k] > 0 else '-'}{'xyz'[k]}" for k in named)
