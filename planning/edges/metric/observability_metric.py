"""The observability metric: C = sum of f f^T over control points, and C^-1, per degree of freedom.

C [px^2 per m^2, m rad, rad^2] is the information of the edges for noise of one pixel across them; C^-1 the
covariance of the pose then. Both are about the point o and along R's axes (`edge_motion.py`). Where C is
singular, what it cannot tell is infinite, and said in words.
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.planning.edges.metric.edge_motion import DEGREES_OF_FREEDOM
from polhode.records import Bools

UNOBSERVABLE_INFORMATION = 1e-9
"""A direction with less than this share of the largest information, shifts counted in radii, is not seen."""
UNOBSERVABLE_SIGMA = 5.0
"""Nor is one whose sigma, for noise of one pixel, exceeds this many radii or radians."""


@dataclass(frozen=True)
class EdgeObservability:
    """What the edges of one view, or of several together, tell of the pose."""

    C: Array
    """(6, 6) information for one pixel of noise"""
    radius_m: float
    """Half the body's diameter: with it shifts and turns are compared"""
    points: int
    """control points"""

    @property
    def scale(self) -> Array:
        """(6,) radius for shifts [m], 1 for turns [rad]."""
        return np.array([self.radius_m] * 3 + [1.0] * 3)

    @property
    def scaled(self) -> tuple[Array, Array]:
        """Information (6,) for shifts in radii and turns in radians, ascending, and its directions (6, 6)."""
        values, directions = np.linalg.eigh(self.C * np.outer(self.scale, self.scale))
        return np.maximum(values, 0.0), directions

    @property
    def unseen(self) -> Array:
        """(k, 6) directions that the edges do not tell: shifts in radii, turns in radians, unit length."""
        values, directions = self.scaled
        return np.asarray(directions[:, ~_is_seen(values)].T)

    @property
    def covariance(self) -> Array:
        """C^-1 (6, 6) [m^2, m rad, rad^2] for one pixel of noise; inf on the diagonal where it is not seen.

        A degree of freedom that is not seen has covariances of NaN.
        """
        values, directions = self.scaled
        seen = _is_seen(values)
        inverse = (directions[:, seen] / values[seen]) @ directions[:, seen].T
        covariance = inverse * np.outer(self.scale, self.scale)
        lost = (directions[:, ~seen] ** 2).sum(axis=1) > 1e-6
        covariance[lost, :] = np.nan
        covariance[:, lost] = np.nan
        covariance[lost, lost] = np.inf
        return np.asarray(covariance)

    @property
    def sigma(self) -> Array:
        """(6,) roots of C^-1's diagonal [m/px, rad/px]."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    @property
    def position_dop(self) -> float:
        """Root of the sum of the shifts' variances [m/px]: the PDOP of GPS."""
        return float(np.linalg.norm(self.sigma[:3]))

    @property
    def attitude_dop(self) -> float:
        """The same of the turns [rad/px]."""
        return float(np.linalg.norm(self.sigma[3:]))

    @property
    def geometric_dop(self) -> float:
        """Root of the sum of all variances, shifts in radii [1/px]."""
        return float(np.linalg.norm(self.sigma / self.scale))

    @property
    def condition(self) -> float:
        """Largest over smallest information, shifts in radii; inf where something is not seen."""
        values, _ = self.scaled
        return float(values[-1] / values[0]) if _is_seen(values).all() else np.inf

    def told(self) -> str:
        """What the edges do not tell, in words; empty where they tell all."""
        if self.points == 0:
            return "no edge is in sight: nothing is told"
        return "; ".join(_in_words(direction) for direction in self.unseen)


def observability(f: Array, weight: Array, radius_m: float) -> EdgeObservability:
    """C = sum of w f f^T over f (m, 6), weights (m,)."""
    return EdgeObservability((f * weight[:, None]).T @ f, radius_m, len(f))


def _is_seen(values: Array) -> Bools:
    """(6,) of ascending information: true where it counts as seen."""
    least = max(UNOBSERVABLE_INFORMATION * float(values[-1]), 1.0 / UNOBSERVABLE_SIGMA**2)
    return np.asarray(values > least)


def _in_words(direction: Array) -> str:
    """A motion (6,) as words."""
    shift, turn = float(np.linalg.norm(direction[:3])), float(np.linalg.norm(direction[3:]))
    if turn < 0.1:
        return f"shifts along {_axis(direction[:3])} are not seen"
    if shift < 0.1:
        return f"turns about {_axis(direction[3:])} are not seen"
    return (
        f"turns about {_axis(direction[3:])} with shifts along {_axis(direction[:3])} "
        f"({shift / turn:.2f} radii a radian) are not seen"
    )


def _axis(v: Array) -> str:
    """x, y, z of the camera where it is nearly one of them, else its components."""
    unit = v / np.linalg.norm(v)
    main = int(np.argmax(np.abs(unit)))
    if abs(unit[main]) > 0.995:
        return f"the camera's {DEGREES_OF_FREEDOM[main]} axis"
    unit = unit * np.sign(unit[main])
    return f"({unit[0]:.2f}, {unit[1]:.2f}, {unit[2]:.2f}) of the camera"
