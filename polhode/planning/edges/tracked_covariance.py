"""A covariance of tracked poses that has what the tracker does not know.

The tracker states P, of noise alone. It does not know edges that the model lacks: shadows beside small
plates, parts that overlap without a common edge. The image tells of them by its agreement with the edges that
are known, and what is expected of a pose tells of displacements D (``expected_tracking.py``).
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array


@dataclass(frozen=True)
class TrackedCovariance:
    """S = a (1 + c (1 - agreement)) P + b D; unless given, fitted to 1,400 trials of 14 bodies.

    ``python -m lab.edges.expected_errors`` fits them. Too small for bodies of revolution, and for thin
    parts in one plane (docs/observability.md).
    """

    noise: float = 0.68
    """a"""
    displacement: float = 0.15
    """b"""
    disagreement: float = 16.0
    """c"""

    def of(self, stated: Array, displacement: Array, agreement: Array | float) -> Array:
        """S (..., 6, 6) [m^2, m rad, rad^2] of P and D (..., 6, 6) and agreements (...)."""
        size = self.noise * (1.0 + self.disagreement * (1.0 - np.asarray(agreement)))
        return np.asarray(size[..., None, None] * stated + self.displacement * displacement)
