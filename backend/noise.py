"""The noise of the pixels, from the residuals."""

from dataclasses import dataclass

import numpy as np

from backend.gauss_newton import GaussNewton
from backend.iterate import Iterate
from backend.problem import MotionData, hold
from polhode.lie import Array

MAD_TO_SIGMA = 1.4826
LIMITS = (0.05, 20.0)
LEAST_OBSERVATIONS = 30
"""Fewer repeated observations say nothing reliable about their noise."""


@dataclass(frozen=True)
class NoiseScales:
    """Factors on the stated standard deviations of (u, v) and of the disparity."""

    uv: float
    disparity: float

    def apply(self, sigma_px: Array) -> Array:
        """Stated (M, 3) -> estimated standard deviations."""
        return np.asarray(sigma_px * np.array([self.uv, self.uv, self.disparity]))


def estimate_noise(data: MotionData, solver: GaussNewton, iterate: Iterate) -> NoiseScales:
    """Median absolute deviation of the whitened residuals, corrected for the freedom that the fit took.

    A landmark of n observations takes 1/n of their freedom, and 6 numbers a frame are fitted to all.
    """
    residuals, _ = solver.residuals(hold(data, iterate), iterate.vector())
    count = np.diff(data.start)[data.landmark]
    repeated = count >= 2
    if repeated.sum() < LEAST_OBSERVATIONS:
        return NoiseScales(1.0, 1.0)
    free = 1.0 - 1.0 / count[repeated] - min(2.0 * data.n_frames / len(data.frame), 0.3)
    whitened = np.abs(residuals[repeated]) / np.sqrt(np.maximum(free, 0.1))[:, None]
    uv, disparity = np.median(whitened[:, :2]), np.median(whitened[:, 2])
    low, high = LIMITS
    return NoiseScales(
        float(np.clip(MAD_TO_SIGMA * uv, low, high)), float(np.clip(MAD_TO_SIGMA * disparity, low, high))
    )
