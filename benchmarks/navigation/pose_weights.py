"""How much a navigation filter believes a tracked pose: always alike, by edges found, or by the metric.

Each weighting answers a `TrackedPose` with the information (6, 6) of its error (`edge_motion.pose_error`), or
None for one that is not used.
"""

from dataclasses import dataclass
from typing import Protocol

from polhode.lie import Array


@dataclass(frozen=True)
class TrackedPose:
    """What an edge tracker hands on for one image."""

    X_RG: Array
    """(4, 4) the pose found"""
    information: Array
    """(6, 6) inverse of the calibrated covariance; singular where edges do not tell"""
    found_share: float
    """control points found over expected: the binary metric's number"""
    residual: float
    """what is left across the edges, over what the error model lets expect"""


class Weighting(Protocol):
    """From a tracked pose to the information that a filter gives it."""

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """(6, 6), or None: not used."""
        ...


@dataclass(frozen=True)
class Fixed:
    """Every pose alike."""

    information: Array
    """(6, 6)"""

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """The constant."""
        return self.information


@dataclass(frozen=True)
class Gated:
    """Every pose alike, if enough of its edges were found: the binary metric."""

    information: Array
    """(6, 6)"""
    min_found: float
    """share of control points"""

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """The constant, or None for a pose of few edges."""
        return self.information if tracked.found_share >= self.min_found else None


@dataclass(frozen=True)
class Calibrated:
    """Each pose by the covariance of its own view."""

    variance_factor: float = 1.0
    """by which covariances are multiplied"""

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """Of the view; None where it tells nothing."""
        return tracked.information / self.variance_factor if tracked.information.any() else None


@dataclass(frozen=True)
class ResidualChecked:
    """Another weighting, without the poses at which edges do not lie where they should.

    A tracker that converged on a wrong pose reports a small covariance all the same; its residuals tell.
    """

    weighting: Weighting
    max_residual: float

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """The other's answer, or None for a pose with large residuals."""
        return self.weighting(tracked) if tracked.residual <= self.max_residual else None
