"""Edges in the colours of a value: tubes along the edges of a mesh, and figures of a view."""

from dataclasses import dataclass

import numpy as np
import trimesh
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose, transform_points
from polhode.planning.edges.metric.edge_motion import DEGREES_OF_FREEDOM
from polhode.planning.edges.model.edge_model import EdgeModel
from polhode.planning.edges.model.visible_edges import ControlPoints, control_points

COLOURS = "plasma"
TUBE = 0.006
"""Radius of the tubes, as a share of the body's radius."""
SIDES = 6
BODY_RGB = (200, 200, 205)
LEGEND_STEPS = 5
DRAWN_STEP_PX = 4.0


@dataclass(frozen=True)
class Legend:
    """Values that the colours stand for."""

    values: Array
    """(5,) from the lowest to the highest"""
    rgb: Array
    """(5, 3) of 0 to 255"""


def colours_of(values: Array, highest: float | None = None) -> tuple[Array, Legend]:
    """Colours (n, 3) of 0 to 255 for values (n,) from 0 to the highest, and their legend.

    Infinite values have the highest colour, NaN the lowest.
    """
    finite = values[np.isfinite(values)]
    top = max(float(finite.max()) if len(finite) else 1.0, 1e-12) if highest is None else highest
    steps = np.linspace(0.0, top, LEGEND_STEPS)
    shown = np.nan_to_num(values / top, nan=0.0, posinf=1.0)
    return _rgb(shown), Legend(steps, _rgb(steps / top))


def coloured_body(
    model: EdgeModel, values: Array, highest: float | None = None
) -> tuple[trimesh.Trimesh, Legend]:
    """The body in grey, its edges as tubes and its smooth parts in the colours of values (size,)."""
    rgb, legend = colours_of(values, highest)
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
    tubes = [
        _tube(ends, TUBE * model.radius_m, rgb[k])
        for k, ends in enumerate(model.ends_G)
        if np.isfinite(values[k])
    ]
    tubes += [
        _tube(model.ends_G[k], 1.5 * TUBE * model.radius_m, rgb[k])
        for k in np.flatnonzero(~np.isfinite(values[:segments]))
    ]
    whole = trimesh.util.concatenate([corners, *tubes])
    assert isinstance(whole, trimesh.Trimesh)
    return whole, legend


def picture(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    values: Array,
    titles: tuple[str, ...] = DEGREES_OF_FREEDOM,
    unit: str = "share of the variance",
) -> Figure:
    """A figure with one panel for each column of values (size, k): the visible edges, coloured by value."""
    points = control_points(model, rig, X_RG, DRAWN_STEP_PX)
    pieces = _pieces(points)
    backdrop = _faces(model, rig, X_RG)
    columns = min(3, values.shape[1])
    rows = -(-values.shape[1] // columns)
    figure = Figure(figsize=(4.4 * columns, 3.5 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    low, high = points.uv_px.min(axis=0) - 20.0, points.uv_px.max(axis=0) + 20.0
    for k in range(values.shape[1]):
        panel = figure.add_subplot(rows, columns, k + 1)
        column = values[:, k]
        finite = column[np.isfinite(column)]
        top = max(float(finite.max()) if len(finite) else 1.0, 1e-12)
        panel.add_collection(PolyCollection(list(backdrop), facecolor="0.93", edgecolor="none"))
        shown = np.nan_to_num(column[points.feature], nan=0.0, posinf=top)
        norm = Normalize(0.0, top)
        lines = LineCollection(list(pieces), array=shown, cmap=COLOURS, norm=norm, linewidths=2.5)
        panel.add_collection(lines)
        panel.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal", title=titles[k])
        panel.set(xticks=[], yticks=[])
        figure.colorbar(ScalarMappable(norm, COLOURS), ax=panel, shrink=0.85)
    figure.suptitle(unit)
    return figure


def view_panel(panel: Axes, model: EdgeModel, rig: RectifiedRig, X_RG: Array, points: ControlPoints) -> None:
    """Draw the body and the visible edges at their image positions, outlines in another colour."""
    drawn = control_points(model, rig, X_RG, DRAWN_STEP_PX)
    drawn = drawn[np.isin(drawn.feature, points.feature)]
    panel.add_collection(PolyCollection(list(_faces(model, rig, X_RG)), facecolor="0.9", edgecolor="none"))
    outline = drawn.feature >= len(model.ends_G)
    for which, colour, name in (~outline, "C0", "edges"), (outline, "C3", "outlines"):
        if which.any():
            panel.add_collection(LineCollection(list(_pieces(drawn[which])), colors=colour, label=name))
    panel.set(xlim=(-0.5, rig.width_px - 0.5), ylim=(rig.height_px - 0.5, -0.5), aspect="equal")
    panel.set(xticks=[], yticks=[])
    if len(drawn):
        panel.legend(loc="lower right", fontsize=8, frameon=False)
    else:
        panel.text(0.5, 0.5, "no visible edge", transform=panel.transAxes, ha="center")


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


def _tube(ends: Array, radius_m: float, rgb: Array) -> trimesh.Trimesh:
    tube: trimesh.Trimesh = trimesh.creation.cylinder(radius_m, segment=ends, sections=SIDES)
    return trimesh.Trimesh(
        tube.vertices, tube.faces, vertex_colors=_rgba(np.tile(rgb, (len(tube.vertices), 1))), process=False
    )


def _rgb(shares: Array) -> Array:
    """(n, 3) of 0 to 255."""
    return np.asarray(np.round(255.0 * colormaps[COLOURS](np.clip(shares, 0.0, 1.0))[:, :3]))


def _rgba(rgb: Array) -> Array:
    return np.asarray(np.hstack([rgb, np.full((len(rgb), 1), 255.0)]).astype(np.uint8))
