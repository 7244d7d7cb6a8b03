"""The frame G of the window: which pair fixes it, and where it is in the one before, when the map was lost.

N and P survive a restart: states are comparable throughout. G is that of the pair that fixes it, by whose
time it is named: the same name in two runs of a sequence is the same frame.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, log_so3


@dataclass(frozen=True)
class FrameOfReference:
    """One frame G."""

    name: str
    """By the time of the pair that fixes it"""
    before: str = ""
    """The frame before, in whose axes its pose is given; empty: it is the first one"""
    X_before: Array | None = None
    """(4, 4) its pose in the frame before; None: no landmarks connect them"""
    covariance: Array | None = None
    """(6, 6) of the translation t [m] and the rotation a [rad] along the axes of the frame before:
    p_before = Exp(a) X_before p + t"""

    @property
    def words(self) -> str:
        """Where it is."""
        if self.X_before is None or self.covariance is None:
            return f"{self.name}, whose pose in {self.before or 'an earlier one'} is not known"
        sigma = np.sqrt(np.diagonal(self.covariance))
        numbers = (*self.X_before[:3, 3], *log_so3(self.X_before[:3, :3]))
        pose = [f"{value:.5g}+-{s:.2g}" for value, s in zip(numbers, sigma, strict=True)]
        return f"{self.name}, in {self.before} at {' '.join(pose[:3])} m, turned by {' '.join(pose[3:])} rad"
