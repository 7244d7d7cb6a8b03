"""Figures of the metric along a trajectory, and of the contribution of each edge."""

from collections.abc import Callable

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM
from polhode.planning.edges.visible_edges import SPACING_PX, control_points
from polhode.planning.observability.assess import Assessment
from polhode.report.pictures.body_views import png
from polhode.runtime.drawing_style import default_style


@default_style
def draw_metric(assessment: Assessment) -> bytes:
    """A PNG: sigmas of translations and rotations, length of visible edges and range, over time."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    time, sigma, expected = assessment.subject.time_s, assessment.sigma, assessment.expected_sigma
    for panel, first, scale, quantity in (
        (panels[0], 0, 1e3, "translation [mm]"),
        (panels[1], 3, np.degrees(1.0), "rotation [deg]"),
    ):
        for k in range(3):
            values, of_tracker = (
                np.where(np.isfinite(each[:, first + k]), scale * each[:, first + k], np.nan)
                for each in (sigma, expected)
            )
            style = {"color": f"C{k}", "linewidth": 1.2}
            panel.plot(time, values, ".-", label=DEGREES_OF_FREEDOM[first + k], markersize=4, **style)
            panel.plot(time, of_tracker, ":", **style)
        panel.plot([], [], ":", color="0.3", label="expected of a\ntracker")
        lost = ~np.isfinite(sigma[:, first : first + 3]).all(axis=1)
        for at in time[lost]:
            panel.axvline(at, color="0.85", linewidth=3.0, zorder=0)
        if lost.any():
            panel.plot([], [], color="0.85", linewidth=3.0, label="not fully determined")
        if np.isfinite(sigma[:, first : first + 3]).any():
            panel.set_yscale("log")
        else:
            panel.text(0.5, 0.5, "not determined at any pose", transform=panel.transAxes, ha="center")
            panel.set_yticks([])
        panel.set_ylabel(f"sigma of {quantity}")
        panel.grid(True, which="both", color="0.9", linewidth=0.6)
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    panels[0].set_title(
        f"Uncertainty of the pose from edges, for {assessment.sigma_px:g} px normal to them "
        f"every {SPACING_PX:g} px",
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
    return png(figure)


@default_style
def draw_contributions(assessment: Assessment, k: int, step_px: float = 4.0) -> bytes:
    """A PNG: the share of each edge in the variance of each degree of freedom, seen from view k."""
    shares, subject = np.nan_to_num(assessment.edges.share), assessment.subject
    model, rig, X_RG = subject.model, subject.rig, assessment.views[k].X_RG
    points = control_points(model, rig, X_RG, step_px)
    # short lines along the edges (m, 2, 2) [px]
    half = 0.55 * step_px * np.stack([-points.normal_px[:, 1], points.normal_px[:, 0]], axis=1)
    pieces = np.stack([points.uv_px - half, points.uv_px + half], axis=1)
    figure = Figure(figsize=(13.2, 7.0), layout="constrained")
    low, high = points.uv_px.min(axis=0) - 20.0, points.uv_px.max(axis=0) + 20.0
    backdrop = _backdrop(model, rig, X_RG, low, high)
    # many edges are drawn with thin lines
    width_pt = 1.2 if len(np.unique(points.feature)) > 400 else 2.5
    for d, degree in enumerate(DEGREES_OF_FREEDOM):
        panel = figure.add_subplot(2, 3, d + 1)
        backdrop(panel)
        shown, norm = shares[points.feature, d], Normalize(0.0, max(float(shares[:, d].max()), 1e-12))
        # the largest values last: among many edges they would be covered
        order = np.argsort(shown, kind="stable")
        panel.add_collection(
            LineCollection(
                list(pieces[order]), array=shown[order], cmap="plasma", norm=norm, linewidths=width_pt
            )
        )
        panel.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal", title=degree)
        panel.set(xticks=[], yticks=[])
        figure.colorbar(ScalarMappable(norm, "plasma"), ax=panel, shrink=0.85)
    figure.suptitle(f"share of the variance along the trajectory, seen at {subject.time_s[k]:g} s")
    return png(figure)


def _backdrop(
    model: EdgeModel, rig: RectifiedRig, X_RG: Array, low: Array, high: Array
) -> Callable[[Axes], object]:
    """A function that draws the faces towards the camera into a panel from low to high (2,) [px].

    More than a thousand are drawn as an image, of 700 px across.
    """
    triangles, normals = np.asarray(model.surface.triangles), np.asarray(model.surface.face_normals)
    towards = np.einsum("fk,fk->f", normals, inverse_pose(X_RG)[:3, 3] - triangles[:, 0]) > 0.0
    corners = transform_points(X_RG, triangles[towards].reshape(-1, 3)).reshape(-1, 3, 3)
    faces_px = np.asarray(rig.project(corners[corners[..., 2].min(axis=1) > 0.0])[..., :2])
    if len(faces_px) <= 1000:
        return lambda panel: panel.add_collection(
            PolyCollection(list(faces_px), facecolor="0.92", edgecolor="none")
        )
    scale, bits = 700 / (high[0] - low[0]), 4
    covered = np.zeros((max(1, int(np.ceil(scale * (high[1] - low[1])))), 700), np.uint8)
    places = np.round(np.clip(2**bits * scale * (faces_px - low), -1e8, 1e8)).astype(np.int32)
    for corner in places:
        cv2.fillConvexPoly(covered, corner, 1, shift=bits)
    rgba = np.array([to_rgba("0.92", 0.0), to_rgba("0.92")])[covered]
    bottom = low[1] + len(covered) / scale
    return lambda panel: panel.imshow(rgba, extent=(low[0], high[0], bottom, low[1]))
