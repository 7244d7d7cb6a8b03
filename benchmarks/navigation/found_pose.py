"""A pose found from edges, as records keep it: what it needs for any calibration of its covariance."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.edges.tracking.calibrated_covariance import EdgeNoise, NoiseParts
from benchmarks.navigation.pose_weights import TrackedPose
from polhode.lie import Array
from polhode.planning.edges.observability_metric import observable_covariance
from polhode.records import Ints

TOLD = 1e-9
"""Variances below this share of the largest, shifts in radii, belong to motions that edges do not tell."""


@dataclass(frozen=True)
class FoundPose:
    """A pose (4, 4) and how errors of edges spread into it."""

    X_RG: Array
    noise: NoiseParts
    """of this fit alone; without rows and columns where edges do not tell"""
    found_share: float
    doubts: dict[str, float]
    """statistics that are larger on wrong poses"""

    def tracked(self, levels: EdgeNoise, doubt: str, radius_m: float) -> TrackedPose:
        """With the covariance of these levels, and one of the statistics."""
        scale = np.array([radius_m] * 3 + [1.0] * 3)
        covariance = levels.covariance(self.noise)[0] / np.outer(scale, scale)
        values, directions = np.linalg.eigh(covariance)
        told = values > TOLD * values[-1]
        D = directions[:, told] / scale[:, None]
        return TrackedPose(self.X_RG, (D / values[told]) @ D.T, self.found_share, self.doubts[doubt])

    def line(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "pose": self.X_RG[:3].ravel().tolist(),
            "parts": self.noise.parts.ravel().tolist(),
            "residual_px": float(self.noise.residual_px[0]),
            "found": self.found_share,
            "doubts": self.doubts,
        }


def from_line(line: dict[str, Any]) -> FoundPose:
    """From JSON."""
    X = np.vstack([np.reshape(line["pose"], (3, 4)), [0.0, 0.0, 0.0, 1.0]])
    noise = NoiseParts(np.reshape(line["parts"], (1, 3, 6, 6)), np.array([line["residual_px"]]))
    return FoundPose(X, noise, line["found"], line["doubts"])


def spread(f: Array, weight: Array, of_edge: Ints, sign: Ints, radius_m: float) -> tuple[Array, Array]:
    """From offsets (m,) to the step of the fit (6, m), and its covariances for unit noise (3, 6, 6).

    `calibrated.noise_parts` where all is told. Along motions that edges do not tell the fit makes no step.
    """
    weighted = f * weight[:, None]
    gain = observable_covariance(weighted.T @ f, radius_m) @ weighted.T
    shared = np.zeros((6, int(of_edge.max(initial=-1)) + 1))
    np.add.at(shared.T, of_edge, gain.T)
    limb = gain @ sign
    return gain, np.stack([gain @ gain.T, shared @ shared.T, np.outer(limb, limb)])
