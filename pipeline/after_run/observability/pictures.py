"""Figures of the metric along the trajectory, the visible edges, and the contribution of each edge."""

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from polhode.pipeline.after_run.observability.assess import Assessment
from polhode.planning.edges.metric.edge_motion import DEGREES_OF_FREEDOM
from polhode.planning.edges.metric.pictures import picture, view_panel

VIEWS = 6
DPI = 100
_COLOURS = ("C0", "C1", "C2")


def draw_metric(assessment: Assessment) -> bytes:
    """A PNG: sigmas of translations and rotations, length of visible edges and range, over time."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(3, 1, sharex=True)
    time, sigma = assessment.subject.time_s, assessment.sigma
    for panel, first, scale, quantity in (
        (panels[0], 0, 1e3, "translation [mm]"),
        (panels[1], 3, np.degrees(1.0), "rotation [deg]"),
    ):
        for k in range(3):
            values = np.where(np.isfinite(sigma[:, first + k]), scale * sigma[:, first + k], np.nan)
            name = DEGREES_OF_FREEDOM[first + k]
            panel.plot(time, values, ".-", color=_COLOURS[k], label=name, linewidth=1.2, markersize=4)
        lost = ~np.isfinite(sigma[:, first : first + 3]).all(axis=1)
        for at in time[lost]:
            panel.axvline(at, color="0.85", linewidth=3.0, zorder=0)
        if lost.any():
            panel.plot([], [], color="0.85", linewidth=3.0, label="not fully determined")
        if np.isfinite(sigma[:, first : first + 3]).any():
            panel.set_yscale("log")
        panel.set_ylabel(f"sigma of {quantity}")
        panel.grid(True, which="both", color="0.9", linewidth=0.6)
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    panels[0].set_title(
        f"Uncertainty of the pose from edges, for {assessment.sigma_px:g} px normal to them "
        f"every {assessment.spacing_px:g} px",
        loc="left",
    )
    panels[2].plot(time, [view.length_px for view in assessment.views], ".-", color="0.3", markersize=4)
    panels[2].set(xlabel="time [s]", ylabel="visible edges [px]")
    panels[2].set_ylim(bottom=0.0)
    panels[2].grid(True, color="0.9", linewidth=0.6)
    distance = panels[2].twinx()
    distance.plot(time, [view.range_m for view in assessment.views], "--", color="C3", linewidth=1.2)
    distance.ticklabel_format(axis="y", useOffset=False)
    distance.set_ylabel("range [m]", color="C3")
    return _png(figure)


def draw_views(assessment: Assessment) -> bytes:
    """A PNG: the visible edges in up to six views of the trajectory."""
    count = min(VIEWS, len(assessment.views))
    chosen = np.unique(np.linspace(0, len(assessment.views) - 1, count).round().astype(int))
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(4.4 * columns, 3.7 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    for place, k in enumerate(chosen):
        view = assessment.views[k]
        panel = figure.add_subplot(rows, columns, place + 1)
        view_panel(panel, assessment.subject.model, assessment.subject.rig, view.X_RG, view.points)
        panel.set_title(
            f"{assessment.subject.time_s[k]:g} s, {view.range_m:.2f} m, {view.expected_edges} edges",
            fontsize=10,
        )
    return _png(figure)


def draw_contributions(assessment: Assessment, k: int) -> bytes:
    """A PNG: the share of each edge in the variance of each degree of freedom, seen from view k."""
    shares = np.nan_to_num(assessment.edges.share)
    subject = assessment.subject
    unit = f"share of the variance along the trajectory, seen at {subject.time_s[k]:g} s"
    return _png(picture(subject.model, subject.rig, assessment.views[k].X_RG, shares, unit=unit))


def _png(figure: Figure) -> bytes:
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI, metadata={"Software": None})
    return content.getvalue()
