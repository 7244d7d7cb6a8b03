"""A run in a few lines: what an interpreter and a notebook show of it."""

from pathlib import Path

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import Trajectory

COLOURS = {"ok": "#1a7f37", "degraded": "#9a6700", "failed": "#cf222e"}
RPM = 30.0 / np.pi


def card_text(folder: Path, summary: Summary) -> str:
    """One line."""
    parts = [summary.status, f"{summary.frames_used} of {summary.frames} frames"]
    parts += [f"{name} {value}" for name, value in _inertia_ratios(summary)]
    return f"<polhode.Run {folder}: {', '.join(parts)}>"


def card_html(folder: Path, summary: Summary, trajectory: Trajectory | None) -> str:
    """A small table; everything that comes from files is escaped."""
    rows = [
        ("status", Markup("<b style='color: {}'>{}</b>").format(COLOURS[summary.status], summary.status)),
        *(("", reason) for reason in (summary.verdict.reasons if summary.verdict is not None else ())),
        ("frames", f"{summary.frames_used} of {summary.frames} used, {summary.duration_s:g} s"),
        ("landmarks", f"{summary.landmarks}, {summary.observations} observations"),
    ]
    if trajectory is not None:
        rate_rpm = float(np.median(np.linalg.norm(trajectory.w_P, axis=1))) * RPM
        rows.append(("rate", f"{rate_rpm:.2f} RPM (median)"))
        rows.append(("position", f"sigma {_millimetres(trajectory.sigma_r)} (median along an axis)"))
    rows += _inertia_ratios(summary)
    if summary.com_G is not None and summary.identifiable is not None:
        known = "determined" if summary.identifiable.com else "not determined in every direction"
        rows.append(("centre of mass", known))
    body = Markup("").join(
        Markup("<tr><th style='text-align: left'>{}</th><td style='text-align: left'>{}</td></tr>").format(
            *row
        )
        for row in rows
    )
    return str(Markup("<table><caption>polhode.Run <code>{}</code></caption>{}</table>").format(folder, body))


def _inertia_ratios(summary: Summary) -> list[tuple[str, str]]:
    """k1 and k2 with their standard deviations; none before there was an estimate."""
    found = summary.inertia
    if found is None:
        return []
    variances = (found.cov[0][0], found.cov[1][1])
    return [
        (name, f"{value:.4f} +- {np.sqrt(variance):.4f}" if variance is not None else "not determined")
        for name, value, variance in zip(("k1", "k2"), (found.k1, found.k2), variances, strict=True)
    ]


def _millimetres(sigma_m: NDArray[np.float64]) -> str:
    middle = float(np.median(sigma_m))
    return f"{middle * 1e3:.2f} mm" if np.isfinite(middle) else "unbounded"
