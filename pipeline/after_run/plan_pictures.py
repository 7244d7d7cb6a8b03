"""Pictures of a plan: the keep-out volume with the body in it, the speed of the surface, the path of an
inspector in the corridor. None of them is a result: if one cannot be made, there is a warning.
"""

import io
import logging
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from polhode.lie import Array
from polhode.mapping.mesh_viewer import MeshView, MeshViewer
from polhode.pipeline.after_run.plan import Plan
from polhode.pipeline.pictures.body_views import ALONG_AXES, OBLIQUE, Direction, round_length_mm
from polhode.pipeline.report.figures.plot import FAINT, INK
from polhode.planning.approach.surface_speed import SurfaceSpeed
from polhode.planning.keep_out.volumes import KeepOut
from polhode.records import SurfaceModel

SIDE_PX, DPI = 340, 100
GROUND = np.array((0.925, 0.94, 0.95))
VOLUME, NOW, END = (np.array(rgb) for rgb in ((0.27, 0.45, 0.72), (0.93, 0.93, 0.90), (0.95, 0.62, 0.25)))
VEIL = 0.35
"""How much of a body's colour the volume before it takes."""
LIGHT = np.array((-0.35, 0.45, 0.82))
"""Left, above, towards the eye."""
SPEED_MAP = "viridis"

_log = logging.getLogger(__name__)


def plan_pictures(plan: Plan, grapples: Sequence[Any]) -> dict[str, bytes]:
    """PNG by name, of what the plan has; ``grapples`` as in planning.json."""
    makers: dict[str, Callable[[], bytes]] = {}
    keep, surface, speed, path = plan.keep_out, plan.surface, plan.speed, plan.corridor
    if keep is not None and surface is not None:
        makers["keepout.png"] = lambda: draw_keepout(keep, surface, plan.horizon_s, plan.confidence)
    if speed is not None and surface is not None:
        makers["surface_speed.png"] = lambda: draw_speed(surface, speed, grapples, plan.horizon_s)
    if path is not None and plan.docking is not None:
        makers["corridor.png"] = lambda: draw_corridor(plan)
    pictures = {}
    for name, make in makers.items():
        try:
            pictures[name] = make()
        except Exception as error:  # noqa: BLE001  a picture is no result: the plan goes on without it
            _log.warning("no picture: %s (%s: %s)", name, type(error).__name__, error)
    return pictures


def draw_keepout(keep: KeepOut, surface: SurfaceModel, horizon_s: float, confidence: float) -> bytes:
    """The volume in N from four sides, with the body at the last pair and at the horizon."""
    volume, motion = keep.swept.mesh, keep.instant.motion
    around, body = MeshViewer(volume), MeshViewer(surface.mesh)
    normal_G, normal_N = np.asarray(surface.mesh.vertex_normals), np.asarray(volume.vertex_normals)
    middle = volume.bounds.mean(axis=0)
    sides = (ALONG_AXES[2], ALONG_AXES[0], ALONG_AXES[1], OBLIQUE[0])
    corners = np.asarray(volume.vertices) - middle
    half = 1.05 * max(float(np.abs(corners @ np.stack([d.right, d.up]).T).max()) for d in sides)
    figure, all_axes = _page(2, 2, f"Keep-out volume over {horizon_s:g} s at {confidence:.1%}")
    for axes, side in zip(all_axes, sides, strict=True):
        outer = around.orthographic(middle, side.right, side.up, half, SIDE_PX)
        layers = []
        for k, colour in ((0, NOW), (-1, END)):
            R, p = motion.R_NG[k], motion.p_NG[k]
            view = body.orthographic(R.T @ (middle - p), R.T @ side.right, R.T @ side.up, half, SIDE_PX)
            layers.append((view, _shaded(view, normal_G @ R.T, side, colour)))
        axes.imshow(_veiled(outer, _shaded(outer, normal_N, side, VOLUME), layers), interpolation="nearest")
        _dress(axes, f"from {side.name} of N", half)
    words = (
        f"Blue: the volume, {1e3 * keep.swept.volume_m3:.3g} litres, shown translucent. White: the target at "
        "the last pair; orange: at the horizon, as predicted."
    )
    return _png(figure, words)


def _veiled(outer: MeshView, blue: Array, layers: list[tuple[MeshView, Array]]) -> Array:
    """The nearer body, seen through the volume."""
    image = np.where(outer.hit[..., None], blue, GROUND)
    nearest = np.full(outer.hit.shape, np.inf)
    for view, colours in layers:
        first = view.hit & (np.nan_to_num(view.depth_m, nan=np.inf) < nearest)
        nearest = np.where(first, view.depth_m, nearest)
        veiled = (1.0 - VEIL) * colours + VEIL * np.where(outer.hit[..., None], blue, colours)
        image = np.where(first[..., None], veiled, image)
    return np.asarray(image)


def draw_speed(
    surface: SurfaceModel, speed: SurfaceSpeed, grapples: Sequence[Any], horizon_s: float
) -> bytes:
    """The mesh from six sides of G by the largest speed over the horizon, the slowest points marked."""
    viewer, V = MeshViewer(surface.mesh), np.asarray(surface.mesh.vertices)
    normal = np.asarray(surface.mesh.vertex_normals)
    middle = 0.5 * (V.min(axis=0) + V.max(axis=0))
    axes_of_views = np.concatenate([[d.right, d.up] for d in ALONG_AXES])
    half = 1.08 * float(np.abs((V - middle) @ axes_of_views.T).max())
    values = 1e3 * speed.largest_m_s
    scale = ScalarMappable(
        Normalize(float(values.min()), float(max(values.max(), values.min() + 1e-9))), SPEED_MAP
    )
    figure, all_axes = _page(2, 3, f"Largest speed of the surface over {horizon_s:g} s")
    for axes, side in zip(all_axes, ALONG_AXES, strict=True):
        view = viewer.orthographic(middle, side.right, side.up, half, SIDE_PX)
        light = 0.65 + 0.35 * _cosine(view, normal, side)
        colours = np.asarray(scale.to_rgba(view.values(values)))[..., :3] * light[..., None]
        axes.imshow(np.where(view.hit[..., None], colours, GROUND), interpolation="nearest")
        for number, one in enumerate(grapples, start=1):
            _mark(axes, view, side, np.array(one["p_G"]) - middle, half, str(number))
        _dress(axes, f"from {side.name} of G", half)
    bar = figure.colorbar(scale, ax=all_axes, shrink=0.8, pad=0.02)
    bar.set_label("largest speed [mm/s]", color=INK)
    words = "Numbers: the slowest points that are reachable along their normal, as in planning.json."
    return _png(figure, words)


def _mark(axes: Axes, view: MeshView, side: Direction, p: Array, half: float, text: str) -> None:
    """A ring and its number, unless the point is hidden."""
    x, y = p @ side.right, p @ side.up
    u, v = (0.5 * SIDE_PX * (1.0 + float(each) / half) - 0.5 for each in (x, -y))
    row, column = (min(max(round(each), 0), SIDE_PX - 1) for each in (v, u))
    # the depth counts from the plane through the middle, away from the eye
    depth = view.depth_m[row, column]
    if np.isfinite(depth) and -float(p @ side.eye) > depth + 0.03 * half:
        return
    axes.plot(u, v, "o", markersize=9, markerfacecolor="none", markeredgecolor="white", markeredgewidth=1.6)
    axes.annotate(
        text, (u, v), (7, 5), textcoords="offset points", color="white", size=10, weight="bold",
        path_effects=[withStroke(linewidth=2, foreground=INK)],
    )  # fmt: skip


def draw_corridor(plan: Plan) -> bytes:
    """The path of an inspector that stays at the stand-off, in two projections; its acceleration."""
    path, docking = plan.corridor, plan.docking
    assert path is not None and docking is not None
    figure, (above, beside, time) = _page(
        1, 3, f"Station keeping at {docking.stand_off_m:g} m in the corridor"
    )
    lines = np.unique(np.linspace(0, len(path.time_s) - 1, 25).round().astype(int))
    for axes, (a, b) in ((above, (0, 2)), (beside, (2, 1))):
        for k in lines:
            ends = np.stack([path.tip_N[k], path.place_N[k]])
            axes.plot(ends[:, a], ends[:, b], color=FAINT, linewidth=0.7, zorder=1)
        axes.plot(path.tip_N[:, a], path.tip_N[:, b], color=END, linewidth=1.5, zorder=2)
        dots = axes.scatter(
            path.place_N[:, a], path.place_N[:, b], c=path.time_s, s=9, cmap=SPEED_MAP, zorder=3
        )
        axes.plot(*path.place_N[0, [a, b]], "o", color=INK, markersize=6, zorder=4)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{'xyz'[a]} of N [m]")
        axes.set_ylabel(f"{'xyz'[b]} of N [m]")
        if "xyz"[b] == "y":
            # y of a camera points down
            axes.invert_yaxis()
    figure.colorbar(dots, ax=[above, beside], shrink=0.8, pad=0.02).set_label("time [s]", color=INK)
    acceleration = 1e3 * path.acceleration_N
    for k, name in enumerate("xyz"):
        time.plot(path.time_s, acceleration[:, k], linewidth=1.0, label=f"{name} of N")
    time.plot(path.time_s, np.linalg.norm(acceleration, axis=1), color=INK, linewidth=2.0, label="magnitude")
    time.set_xlabel("time after the last pair [s]")
    time.set_ylabel("acceleration [mm/s²]")
    time.legend(fontsize=8, loc="best")
    for axes in (above, beside, time):
        axes.grid(color="0.92")
        axes.tick_params(labelsize=8)
    words = (
        f"Dots: the inspector, black where it starts; orange: the docking point; grey: the axis. "
        f"{path.delta_v_m_s:.3g} m/s over {plan.horizon_s:g} s."
    )
    return _png(figure, words)


def _shaded(view: MeshView, normals: Array, side: Direction, colour: Array) -> Array:
    """(H, W, 3)"""
    return np.asarray(colour * (0.5 + 0.5 * _cosine(view, normals, side))[..., None])


def _cosine(view: MeshView, normals: Array, side: Direction) -> Array:
    """(H, W) between surface and light; normals (V, 3) in the axes of the side."""
    turned = view.values(normals @ np.stack([side.right, side.up, side.eye]).T)
    length = np.linalg.norm(turned, axis=2)
    cosine = turned @ (LIGHT / np.linalg.norm(LIGHT)) / np.where(length > 0.0, length, 1.0)
    return np.asarray(np.abs(cosine))


def _page(rows: int, columns: int, title: str) -> tuple[Figure, list[Axes]]:
    figure = Figure(
        figsize=(4.3 * columns, 4.3 * rows + 0.9), dpi=DPI, facecolor="white", layout="constrained"
    )
    FigureCanvasAgg(figure)
    figure.suptitle(title, size=14, weight="bold", color=INK)
    return figure, [figure.add_subplot(rows, columns, k + 1) for k in range(rows * columns)]


def _dress(axes: Axes, title: str, half: float) -> None:
    """No ticks, but a length."""
    axes.set_title(title, size=10, color=INK)
    axes.set_axis_off()
    length_m = 1e-3 * round_length_mm(2e3 * half)
    x, y = 0.04 * SIDE_PX, 0.96 * SIDE_PX
    axes.plot(
        (x, x + SIDE_PX * length_m / (2.0 * half)), (y, y), color=INK, linewidth=3, solid_capstyle="butt"
    )
    axes.text(x, y - 7, f"{1e3 * length_m:g} mm", size=8, color=INK)


def _png(figure: Figure, words: str) -> bytes:
    figure.supxlabel(words, size=9, color=INK)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    return content.getvalue()
