"""The observability metric: C = sum of f f^T over control points, and C^-1, per degree of freedom.

C [px^2 per m^2, m rad, rad^2] is the information of the edges for one pixel of noise normal to them; C^-1 is
the covariance of the pose. Both refer to the point o and R's axes (`edge_motion.py`). Where C is singular,
the unobservable variances are infinite, and a description names the directions.
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.planning.edges.metric.edge_motion import DEGREES_OF_FREEDOM
from polhode.records import Bools

UNOBSERVABLE_INFORMATION = 1e-9
"""A direction with less than this share of the largest information, lengths in radii, is unobservable."""
UNOBSERVABLE_SIGMA = 5.0
"""So is one whose sigma, for a noise of one pixel, exceeds this many radii or radians."""


@dataclass(frozen=True)
class EdgeObservability:
    """Information that the edges of one view, or of several together, give about the pose."""

    C: Array
    """(6, 6) information for one pixel of noise"""
    radius_m: float
    """Half the body's diameter: scale at which translations and rotations are compared"""
    points: int
    """number of control points"""

    @property
    def scale(self) -> Array:
        """(6,) radius for translations [m], 1 for rotations [rad]."""
        return np.array([self.radius_m] * 3 + [1.0] * 3)

    @property
    def scaled(self) -> tuple[Array, Array]:
        """Ascending eigenvalues (6,), with translations in radii, rotations in radians; directions (6, 6)."""
        values, directions = np.linalg.eigh(self.C * np.outer(self.scale, self.scale))
        return np.maximum(values, 0.0), directions

    @property
    def unobservable(self) -> Array:
        """(k, 6) unobservable directions: translations in radii, rotations in radians, unit length."""
        values, directions = self.scaled
        return np.asarray(directions[:, ~_is_observable(values)].T)

    @property
    def covariance(self) -> Array:
        """C^-1 (6, 6) [m^2, m rad, rad^2] for one pixel of noise; inf on the diagonal where unobservable.

        The covariances of an unobservable degree of freedom are NaN.
        """
        values, directions = self.scaled
        observable = _is_observable(values)
        inverse = (directions[:, observable] / values[observable]) @ directions[:, observable].T
        covariance = inverse * np.outer(self.scale, self.scale)
        unobservable = (directions[:, ~observable] ** 2).sum(axis=1) > 1e-6
        covariance[unobservable, :] = np.nan
        covariance[:, unobservable] = np.nan
        covariance[unobservable, unobservable] = np.inf
        return np.asarray(covariance)

    @property
    def sigma(self) -> Array:
        """(6,) roots of C^-1's diagonal [m/px, rad/px]."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    @property
    def position_dop(self) -> float:
        """Root of the sum of the translations' variances [m/px], as the PDOP of GPS."""
        return float(np.linalg.norm(self.sigma[:3]))

    @property
    def attitude_dop(self) -> float:
        """Root of the sum of the rotations' variances [rad/px]."""
        return float(np.linalg.norm(self.sigma[3:]))

    @property
    def geometric_dop(self) -> float:
        """Root of the sum of all variances, translations in radii [1/px]."""
        return float(np.linalg.norm(self.sigma / self.scale))

    @property
    def condition(self) -> float:
        """Largest over smallest eigenvalue, translations in radii; inf where a direction is unobservable."""
        values, _ = self.scaled
        return float(values[-1] / values[0]) if _is_observable(values).all() else np.inf

    def describe_unobservable(self) -> str:
        """Description of the unobservable directions; empty where the whole pose is observable."""
        if self.points == 0:
            return "no edge is visible: the whole pose is unobservable"
        return "; ".join(_describe(direction) for direction in self.unobservable)


def observability(f: Array, weight: Array, radius_m: float) -> EdgeObservability:
    """C = sum of w f f^T over f (m, 6), weights (m,)."""
    return EdgeObservability((f * weight[:, None]).T @ f, radius_m, len(f))


def _is_observable(values: Array) -> Bools:
    """(6,) of ascending eigenvalues: true where the direction is observable."""
    lower = max(UNOBSERVABLE_INFORMATION * float(values[-1]), 1.0 / UNOBSERVABLE_SIGMA**2)
    return np.asarray(values > lower)


def _describe(direction: Array) -> str:
    """Description of an unobservable motion (6,)."""
    shift, turn = float(np.linalg.norm(direction[:3])), float(np.linalg.norm(direction[3:]))
    if turn < 0.1:
        return f"translation along {_axis(direction[:3])} is unobservable"
    if shift < 0.1:
        return f"rotation about {_axis(direction[3:])} is unobservable"
    return (
        f"rotation about {_axis(direction[3:])} with translation along {_axis(direction[:3])} "
        f"({shift / turn:.2f} radii per radian) is unobservable"
    )


def _axis(v: Array) -> str:
    """Name of the camera axis that v is nearly parallel to, otherwise its components."""
    unit = v / np.linalg.norm(v)
    main = int(np.argmax(np.abs(unit)))
    if abs(unit[main]) > 0.995:
        return f"the camera's {DEGREES_OF_FREEDOM[main]} axis"
    unit = unit * np.sign(unit[main])
    return f"({unit[0]:.2f}, {unit[1]:.2f}, {unit[2]:.2f}) of the camera"
