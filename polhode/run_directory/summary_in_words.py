"""A summary and its intervals in words, and the centre of mass that the intervals allow."""

import numpy as np

from polhode.geometry.lie import Array
from polhode.run_directory.summary_schema import Summary


def describe_summary(summary: Summary) -> str:
    """Status, frames and inertia ratios in a line."""
    parts = [summary.status, f"{summary.frames_used} of {summary.frames} frames"]
    if (inertia := summary.inertia) is not None:
        for k, (name, value) in enumerate((("k1", inertia.k1), ("k2", inertia.k2))):
            variance = inertia.cov[k][k]
            known = "not determined" if variance is None else f"{value:.4f} +- {np.sqrt(variance):.4f}"
            parts.append(f"{name} {known}")
    return ", ".join(parts)


def describe_intervals(summary: Summary) -> list[str]:
    """One description for each interval; empty: there are none."""
    found = summary.intervals
    if found is None:
        return []
    words = [
        f"{name} from {interval[0]:.2f} to {interval[1]:.2f}"
        for name, interval in (("k1", found.k1), ("k2", found.k2))
        if interval is not None
    ]
    for axis, shift in zip("xyz", found.com_shift_P or (), strict=False):
        if shift is not None:
            low, high = (1e3 * end for end in shift)
            words.append(
                f"centre of mass along the principal axis {axis} {low:+.1f} to {high:+.1f} mm from com_G"
            )
    return words


def possible_com(summary: Summary) -> tuple[Array, float]:
    """The centre of mass (3,) in G [m], and by how much [m] it was moved from com_G into its intervals.

    An estimate of what the motion does not determine may lie outside the body.
    """
    assert summary.com_G is not None and summary.R_GP is not None
    com_G, found = np.array(summary.com_G), summary.intervals
    if found is None or found.com_shift_P is None:
        return com_G, 0.0
    shift_P = np.array([0.0 if each is None else np.clip(0.0, *each) for each in found.com_shift_P])
    return com_G + np.array(summary.R_GP) @ shift_P, float(np.linalg.norm(shift_P))
