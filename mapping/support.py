"""Which voxels are known: seen in enough frames, that agree, and that few frames look through.

A count of frames alone is a poor judge. Two frames that say the same confirm each other; many that say
different things, as windows do on a slant without texture, confirm nothing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.config.mapping import Mapping
from polhode.mapping.blocks import DISTANCE, FREE, SQUARE, VIEWS, WEIGHT
from polhode.records import Bools

Floats = NDArray[np.float32]
_TIMES_USUAL = 2.0
"""Where all depth is poor the limits follow it: so many times the median scatter still counts."""


@dataclass(frozen=True)
class Support:
    """What a voxel must show to count."""

    views: int
    """Frames that saw it"""
    agreeing: float
    """Two frames are enough where they scatter by less [voxels]"""
    scatter: float
    """Frames that scatter by more say nothing [voxels]"""
    carved: float
    """Most of the weight may come from frames that look through: this share"""

    @staticmethod
    def of(config: Mapping, views: int) -> "Support":
        """As configured, with ``views`` frames."""
        return Support(views, config.agreeing_voxels, config.scatter_voxels, config.carved_share)


def known_voxels(values: Floats, voxel_m: float, support: Support) -> Bools:
    """(n, 512): which of the field's voxels (n, 512, 7) count."""
    weight, free, views = values[..., WEIGHT], values[..., FREE], values[..., VIEWS]
    scatter = scatter_m(values) / np.float32(voxel_m)
    usual = _usual(scatter, values, voxel_m)
    seen = views + (free > 0) >= support.views
    confirmed = (views >= 2) & (scatter < max(support.agreeing, usual))
    agree = scatter < max(support.scatter, _TIMES_USUAL * usual)
    # far in front of every surface all frames look through, and that is what they say
    empty = weight <= 0
    solid = free <= support.carved * (weight + free)
    return np.asarray((weight + free > 0) & (seen | confirmed) & (empty | (agree & solid)))


def scatter_m(values: Floats) -> Floats:
    """(n, 512): standard deviation of what frames say of a voxel's distance from the surface [m]."""
    weight = np.maximum(values[..., WEIGHT], np.float32(1e-30))
    mean = values[..., DISTANCE] / weight
    scatter: Floats = np.sqrt(np.maximum(values[..., SQUARE] / weight - mean * mean, np.float32(0.0)))
    return scatter


def _usual(scatter: Floats, values: Floats, voxel_m: float) -> float:
    """Median scatter at the surface [voxels]."""
    distance = np.abs(values[..., DISTANCE])
    near = (values[..., VIEWS] >= 3) & (distance < np.float32(voxel_m) * values[..., WEIGHT])
    return float(np.median(scatter[near])) if near.any() else 0.0
