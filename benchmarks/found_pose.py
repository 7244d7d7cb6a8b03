"""A pose found from edges, as records keep it: what it needs for any calibration of its covariance.

Errors of single control points and errors that all points of an edge share spread into the pose by
C^-1 (sigma^2 sum w^2 f f^T + tau^2 sum over edges of g g^T) C^-1, g = sum of w f over an edge; both parts are
kept for one pixel.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from planning.observability.metric import observability
from planning.observability.pose_weights import TrackedPose
from polhode.lie import Array
from polhode.records import Ints

TOLD = 1e-9
"""Variances below this share of the largest, shifts in radii, belong to motions that edges do not tell."""


@dataclass(frozen=True)
class FoundPose:
    """A pose (4, 4) and how errors of edges spread into it."""

    X_RG: Array
    by_points: Array
    """(6, 6) covariance for sigma of one pixel"""
    by_edges: Array
    """(6, 6) covariance for tau of one pixel"""
    sigma_px: float
    """residuals of its fit"""
    found_share: float
    residual: float
    """what the residual statistic says: larger on wrong poses"""

    def tracked(self, sigma_px: float, tau_px: float, radius_m: float) -> TrackedPose:
        """With the covariance that these errors make."""
        scale = np.array([radius_m] * 3 + [1.0] * 3)
        covariance = (sigma_px**2 * self.by_points + tau_px**2 * self.by_edges) / np.outer(scale, scale)
        values, directions = np.linalg.eigh(covariance)
        told = values > TOLD * values[-1]
        D = directions[:, told] / scale[:, None]
        return TrackedPose(self.X_RG, (D / values[told]) @ D.T, self.found_share, self.residual)

    def line(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "pose": self.X_RG[:3].ravel().tolist(),
            "by_points": self.by_points.ravel().tolist(),
            "by_edges": self.by_edges.ravel().tolist(),
            "sigma_px": self.sigma_px,
            "found": self.found_share,
            "residual": self.residual,
        }


def from_line(line: dict[str, Any]) -> FoundPose:
    """From JSON."""
    X = np.vstack([np.reshape(line["pose"], (3, 4)), [0.0, 0.0, 0.0, 1.0]])
    parts = (np.reshape(line[name], (6, 6)) for name in ("by_points", "by_edges"))
    return FoundPose(X, *parts, line["sigma_px"], line["found"], line["residual"])


def spread(f: Array, weight: Array, of_edge: Ints, radius_m: float) -> tuple[Array, Array, Array]:
    """From offsets (m,) to the step (6, m) of the fit, and the covariances (6, 6) by points and by edges.

    Along motions that the edges do not tell the fit makes no step.
    """
    metric = observability(f, weight, radius_m)
    values, directions = metric.scaled
    told = np.arange(6) >= len(metric.unseen)
    D = directions[:, told] * metric.scale[:, None]
    gain = (D / values[told]) @ D.T @ (f * weight[:, None]).T
    shared = np.zeros((6, int(of_edge.max(initial=-1)) + 1))
    np.add.at(shared.T, of_edge, gain.T)
    return gain, gain @ gain.T, shared @ shared.T
