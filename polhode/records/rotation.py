"""The rotation at the last pair: angular momentum and spin axis, each with its uncertainty."""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array


@dataclass(frozen=True)
class Direction:
    """A direction, whose error is a small turn across it."""

    unit: Array
    """(3,) of unit length"""
    covariance: Array
    """(3, 3) of it [rad^2], 0 along it; inf on the diagonal where undetermined"""

    @property
    def sigma_rad(self) -> float:
        """Along the worse of two axes across it [rad]; inf: undetermined."""
        if not np.isfinite(self.covariance).all():
            return np.inf
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance)[-1], 0.0)))


@dataclass(frozen=True)
class LastRotation:
    """How the target rotates at the last pair. Sigmas are inf where a quantity is undetermined."""

    momentum_N: Direction
    """Of the angular momentum about the centre of mass, in N"""
    momentum_rad_s: float
    """Its size over the middle moment [rad/s]"""
    sigma_momentum_rad_s: float
    spin_N: Direction
    """Of the angular velocity, in N"""
    spin_P: Direction
    """The same in the principal axes"""
    momentum_N_m_s: float | None = None
    """Size of the angular momentum, from known torques [N m s]; None: none are known"""
    sigma_momentum_N_m_s: float | None = None
