"""Figures of the metric along a trajectory; edges in the colours of a value, in views and as tubes."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import trimesh
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.information import EdgeView
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM
from polhode.planning.edges.visible_edges import ControlPoints, control_points
from polhode.planning.observability.assess import Assessment
from polhode.report.pictures.body_views import png
from polhode.runtime.drawing_style import default_style

COLOURS = "plasma"
TUBE = 0.006
"""Radius of the tubes, as a share of the body's radius."""
SIDES = 6
BODY_RGB = (200, 200, 205)
LEGEND_STEPS = 5
DRAWN_STEP_PX = 4.0
LINE_PT, DENSE_LINE_PT = 2.5, 1.2
"""Width of the lines, and where there are many"""
DENSE_EDGES = 400
"""More visible edges are drawn with thin lines."""
DRAWN_FACES = 1000
"""More faces are drawn as an image."""
BACKDROP = "0.92"
SUBPIXEL_BITS = 4
SUBPIXELS = 2**SUBPIXEL_BITS
IMAGE_PX = 700
"""Width of such an image"""


@dataclass(frozen=True)
class Legend:
    """Values that the colours stand for."""

    values: Array
    """(5,) from the lowest to the highest"""
    rgb: Array
    """(5, 3) of 0 to 255"""


def colours_of(values: Array) -> tuple[Array, Legend]:
    """Colours (n, 3) of 0 to 255 for values (n,) from 0 to the highest, and their legend.

    Infinite values have the highest colour, NaN the lowest.
    """
    top = _largest(values)
    steps = np.linspace(0.0, top, LEGEND_STEPS)
    shown = np.nan_to_num(values / top, nan=0.0, posinf=1.0)
    return _rgb(shown), Legend(steps, _rgb(steps / top))


def _largest(values: Array) -> float:
    """Of the finite ones."""
    finite = values[np.isfinite(values)]
    return max(float(finite.max()) if len(finite) else 1.0, 1e-12)


def coloured_body(model: EdgeModel, values: Array) -> tuple[trimesh.Trimesh, Legend]:
    """The body in grey, its edges as tubes and its smooth parts in the colours of values (size,)."""
    rgb, legend = colours_of(values)
    segments = len(model.ends_G)
    body = model.surface.copy()
    of_parts = np.vstack([rgb[segments:], BODY_RGB])[model.part]
    face_rgb = np.where(model.outlined_faces[:, None], of_parts, np.array(BODY_RGB))
    # one vertex for each corner: neighbouring parts differ in colour
    corners = trimesh.Trimesh(
        np.asarray(body.triangles).reshape(-1, 3),
        np.arange(3 * len(body.faces)).reshape(-1, 3),
        vertex_colors=_rgba(np.repeat(face_rgb, 3, axis=0)),
        process=False,
    )
    radius_m = TUBE * model.radius_m * np.where(np.isfinite(values[:segments]), 1.0, 1.5)
    whole = trimesh.util.concatenate([corners, _tubes(model.ends_G, radius_m, rgb[:segments])])
    assert isinstance(whole, trimesh.Trimesh)
    return whole, legend


def view_panel(panel: Axes, model: EdgeModel, rig: RectifiedRig, view: EdgeView) -> None:
    """Draw the body and the visible edges at their image positions, outlines in another colour."""
    X_RG, points = view.X_RG, view.points
    drawn = control_points(model, rig, X_RG, DRAWN_STEP_PX)
    drawn = drawn[np.isin(drawn.feature, points.feature)]
    low, high = np.array([-0.5, -0.5]), np.array([rig.width_px - 0.5, rig.height_px - 0.5])
    _backdrop(_faces(model, rig, X_RG), low, high)(panel)
    outline = drawn.feature >= len(model.ends_G)
    for which, colour, name in (~outline, "C0", "edges"), (outline, "C3", "outlines"):
        if which.any():
            width = _line_pt(drawn, 1.5)
            # one line with gaps is drawn faster than many
            u, v = (
                np.pad(_pieces(drawn[which]), ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
                .reshape(-1, 2)
                .T
            )
            panel.plot(u, v, color=colour, label=name, linewidth=width)
    panel.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal")
    panel.set(xticks=[], yticks=[])
    if len(drawn):
        panel.legend(loc="lower right", fontsize=8, frameon=False)
    else:
        text = f"no visible edge:\n{view.reason}" if view.reason else "no visible edge"
        panel.text(0.5, 0.5, text, transform=panel.transAxes, ha="center", va="center")


def _line_pt(points: ControlPoints, usual: float) -> float:
    """Width of the lines."""
    many = len(np.unique(points.feature)) > DENSE_EDGES
    return min(usual, DENSE_LINE_PT) if many else usual


def _backdrop(faces_px: Array, low: Array, high: Array) -> Callable[[Axes], object]:
    """A function that draws faces (k, 3, 2) [px] into a panel whose window extends from low to high (2,)."""
    if len(faces_px) <= DRAWN_FACES:
        return lambda panel: panel.add_collection(
            PolyCollection(list(faces_px), facecolor=BACKDROP, edgecolor="none")
        )
    scale = IMAGE_PX / (high[0] - low[0])
    covered = np.zeros((max(1, int(np.ceil(scale * (high[1] - low[1])))), IMAGE_PX), np.uint8)
    corners = np.round(np.clip(SUBPIXELS * scale * (faces_px - low), -1e8, 1e8)).astype(np.int32)
    for corner in corners:
        cv2.fillConvexPoly(covered, corner, 1, shift=SUBPIXEL_BITS)
    rgba = np.array([to_rgba(BACKDROP, 0.0), to_rgba(BACKDROP)])[covered]
    bottom = low[1] + len(covered) / scale
    return lambda panel: panel.imshow(rgba, extent=(low[0], high[0], bottom, low[1]))


def _pieces(points: ControlPoints) -> Array:
    """(m, 2, 2) short lines along the edges [px]."""
    along = np.stack([-points.normal_px[:, 1], points.normal_px[:, 0]], axis=1)
    half = 0.55 * DRAWN_STEP_PX * along
    return np.stack([points.uv_px - half, points.uv_px + half], axis=1)


def _faces(model: EdgeModel, rig: RectifiedRig, X_RG: Array) -> Array:
    """(k, 3, 2) projections of the faces that point towards the camera and lie in front of it [px]."""
    eye_G = inverse_pose(X_RG)[:3, 3]
    triangles = np.asarray(model.surface.triangles)
    normals = np.asarray(model.surface.face_normals)
    corners = transform_points(X_RG, triangles.reshape(-1, 3)).reshape(-1, 3, 3)
    towards = np.einsum("fk,fk->f", normals, eye_G - triangles[:, 0]) > 0.0
    before = corners[..., 2].min(axis=1) > 0.0
    return np.asarray(rig.project(corners[towards & before])[..., :2])


def _tubes(ends: Array, radius_m: Array, rgb: Array) -> trimesh.Trimesh:
    """One mesh of tubes around segments (n, 2, 3), of radii (n,), in colours (n, 3)."""
    unit = trimesh.creation.cylinder(1.0, 1.0, sections=SIDES)
    around, count = np.asarray(unit.vertices), len(unit.vertices)
    along = ends[:, 1] - ends[:, 0]
    length_m = np.linalg.norm(along, axis=1)
    axis = along / np.maximum(length_m, 1e-300)[:, None]
    # perpendicular to the axis, from the coordinate axis that is farthest from it
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    first /= np.maximum(np.linalg.norm(first, axis=1), 1e-300)[:, None]
    frame = np.stack([first, np.cross(axis, first), axis], axis=1)
    scale = np.column_stack([radius_m, radius_m, length_m])
    vertices = (around * scale[:, None]) @ frame + ends.mean(axis=1)[:, None]
    faces = np.asarray(unit.faces) + count * np.arange(len(ends))[:, None, None]
    return trimesh.Trimesh(
        vertices.reshape(-1, 3),
        faces.reshape(-1, 3),
        vertex_colors=_rgba(np.repeat(rgb, count, axis=0)),
        process=False,
    )


def _rgb(shares: Array) -> Array:
    """(n, 3) of 0 to 255."""
    return np.asarray(np.round(255.0 * colormaps[COLOURS](np.clip(shares, 0.0, 1.0))[:, :3]))


def _rgba(rgb: Array) -> Array:
    return np.asarray(np.hstack([rgb, np.full((len(rgb), 1), 255.0)]).astype(np.uint8))


VIEWS = 6
_COLOURS = ("C0", "C1", "C2")


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
            values = np.where(np.isfinite(sigma[:, first + k]), scale * sigma[:, first + k], np.nan)
            name = DEGREES_OF_FREEDOM[first + k]
            panel.plot(time, values, ".-", color=_COLOURS[k], label=name, linewidth=1.2, markersize=4)
            of_tracker = np.where(np.isfinite(expected[:, first + k]), scale * expected[:, first + k], np.nan)
            panel.plot(time, of_tracker, ":", color=_COLOURS[k], linewidth=1.2)
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
    return png(figure)


@default_style
def draw_views(assessment: Assessment) -> bytes:
    """A PNG: the visible edges in up to six views of the trajectory."""
    count = min(VIEWS, len(assessment.views))
    chosen = np.unique(np.linspace(0, len(assessment.views) - 1, count).round().astype(int))
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(4.4 * columns, 3.7 * rows), layout="constrained")
    for number, k in enumerate(chosen, start=1):
        view = assessment.views[k]
        panel = figure.add_subplot(rows, columns, number)
        view_panel(panel, assessment.subject.model, assessment.subject.rig, view)
        panel.set_title(
            f"{assessment.subject.time_s[k]:g} s, {view.range_m:.2f} m, {view.expected_edges} edges",
            fontsize=10,
        )
    return png(figure)


@default_style
def draw_contributions(assessment: Assessment, k: int) -> bytes:
    """A PNG: the share of each edge in the variance of each degree of freedom, seen from view k."""
    shares, subject = np.nan_to_num(assessment.edges.share), assessment.subject
    model, rig, X_RG = subject.model, subject.rig, assessment.views[k].X_RG
    points = control_points(model, rig, X_RG, DRAWN_STEP_PX)
    pieces = _pieces(points)
    figure = Figure(figsize=(13.2, 7.0), layout="constrained")
    low, high = points.uv_px.min(axis=0) - 20.0, points.uv_px.max(axis=0) + 20.0
    backdrop = _backdrop(_faces(model, rig, X_RG), low, high)
    width = _line_pt(points, LINE_PT)
    for d, degree in enumerate(DEGREES_OF_FREEDOM):
        panel = figure.add_subplot(2, 3, d + 1)
        backdrop(panel)
        shown, norm = shares[points.feature, d], Normalize(0.0, _largest(shares[:, d]))
        # the largest values last: among many edges they would be covered
        order = np.argsort(shown, kind="stable")
        lines = LineCollection(
            list(pieces[order]), array=shown[order], cmap=COLOURS, norm=norm, linewidths=width
        )
        panel.add_collection(lines)
        panel.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal", title=degree)
        panel.set(xticks=[], yticks=[])
        figure.colorbar(ScalarMappable(norm, COLOURS), ax=panel, shrink=0.85)
    figure.suptitle(f"share of the variance along the trajectory, seen at {subject.time_s[k]:g} s")
    return png(figure)
