"""The table of final standard deviations (thesis table 6.4)."""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.pipeline.report.content import Content


@dataclass(frozen=True)
class SigmaRow:
    """Standard deviations along three axes, as text."""

    name: str
    unit: str
    cells: tuple[str, str, str]


def sigma_rows(content: Content) -> list[SigmaRow]:
    """States averaged over all frames, then the constants; nothing without an estimate."""
    motion, summary = content.motion, content.summary
    if motion is None or summary.inertia is None:
        return []
    path, deg = motion.trajectory, np.rad2deg(1.0)
    cov_com = np.array(summary.cov_com_G, dtype=np.float64)
    cov_axes = np.array(summary.cov_R_GP, dtype=np.float64)
    ratios = np.array(summary.inertia.cov, dtype=np.float64)
    return [
        SigmaRow("position, along N, mean over the frames", "mm", _cells(1e3 * path.sigma_r.mean(axis=0))),
        SigmaRow("velocity, along N, mean", "mm/s", _cells(1e3 * path.sigma_v.mean(axis=0))),
        SigmaRow("attitude, about P, mean", "deg", _cells(deg * path.sigma_theta.mean(axis=0))),
        SigmaRow("angular velocity, along P, mean", "deg/s", _cells(deg * path.sigma_w.mean(axis=0))),
        SigmaRow("centre of mass, along G", "mm", _cells(1e3 * _roots(cov_com))),
        SigmaRow("principal axes, about P", "deg", _cells(deg * _roots(cov_axes))),
        SigmaRow("inertia ratios k1, k2", "", (*_cells(_roots(ratios))[:2], "")),
    ]


def _roots(covariance: Array) -> Array:
    """Standard deviations; infinite where a variance is not a number (null in summary.json)."""
    variance = np.diag(covariance)
    return np.where(np.isfinite(variance), np.sqrt(np.maximum(np.nan_to_num(variance), 0.0)), np.inf)


def _cells(sigma: Array) -> tuple[str, str, str]:
    shown = [f"{value:.3g}" if np.isfinite(value) else "no bound" for value in sigma]
    return (shown[0], shown[1], shown[2] if len(shown) > 2 else "")
