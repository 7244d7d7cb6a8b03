"""The files of ``polhode plan``: meshes, tables, numbers in planning.json, pictures; lines for the screen.

No picture is a result: if one cannot be made, there is a warning.
"""

import json
import logging
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from polhode.files.output.marked_folder import marked_folder, write_files
from polhode.files.ply import binary_ply
from polhode.geometry.lie import Array
from polhode.mapping.visibility import Caster, MeshView, MeshViewer
from polhode.planning.approach.approach_path import ApproachPath
from polhode.planning.approach.corridor import Corridor
from polhode.planning.approach.surface_speed import SurfaceSpeed, slowest_points
from polhode.planning.approach.tumbling_threshold import fuel_share
from polhode.planning.exports.ccsds import tum
from polhode.planning.plan import Plan
from polhode.records.surface import SurfaceModel
from polhode.report.pictures.body_views import (
    ALONG_AXES,
    DPI,
    GROUND,
    OBLIQUE,
    Direction,
    add_scale_bar,
    cosine_to_light,
    png,
)
from polhode.report.plot_style import FAINT, INK
from polhode.runtime.drawing_style import default_style

IN_N = "X_NR: poses in N"
"""How the first line of a planned trajectory begins, after "#"."""

COMMAND = "plan"
FILES = (
    "keepout.ply", "keepout.glb", "keepout.png", "surface_speed.ply", "surface_speed.png", "corridor.csv",
    "corridor.png", "plan.txt", "planning.json",
)  # fmt: skip
"""Files that the command writes; those of an earlier call that this one does not write are removed."""
SIDE_PX = 340
VOLUME, NOW, END = (np.array(rgb) for rgb in ((0.27, 0.45, 0.72), (0.93, 0.93, 0.90), (0.95, 0.62, 0.25)))
VEIL = 0.35
"""Opacity of the volume in front of a body."""
SPEED_MAP = "viridis"
GRAPPLES, MIN_SEPARATION_SHARE = 5, 0.15
"""Grapple points, and the distance between two of them over the body's size."""

_log = logging.getLogger(__name__)


def plan_pictures(plan: Plan, grapples: Sequence[Any]) -> dict[str, bytes]:
    """PNG by name, of what the plan has; ``grapples`` as in planning.json."""
    pictures = {}
    for name, has, make in (
        ("keepout.png", plan.keep_out, draw_keepout),
        ("surface_speed.png", plan.speed, lambda plan: draw_speed(plan, grapples)),
        ("corridor.png", plan.corridor, draw_corridor),
    ):
        try:
            if has is not None:
                pictures[name] = make(plan)
        except Exception as error:  # noqa: BLE001  a picture is no result: the plan goes on without it
            _log.warning("no picture: %s (%s: %s)", name, type(error).__name__, error)
    return pictures


@default_style
def draw_keepout(plan: Plan) -> bytes:
    """The volume in N from four sides, with the body at the last pair and at the horizon seen through it."""
    keep, surface = plan.keep_out, plan.surface
    assert keep is not None and surface is not None
    volume, motion = keep.swept.mesh, keep.instant.motion
    around, body = MeshViewer(volume), MeshViewer(surface.mesh)
    normal_G, normal_N = np.asarray(surface.mesh.vertex_normals), np.asarray(volume.vertex_normals)
    middle = volume.bounds.mean(axis=0)
    sides = (ALONG_AXES[2], ALONG_AXES[0], ALONG_AXES[1], OBLIQUE[0])
    corners = np.asarray(volume.vertices) - middle
    half = 1.05 * max(float(np.abs(corners @ np.stack([d.right, d.up]).T).max()) for d in sides)
    figure, all_axes = _page(
        *(2, 2, f"Keep-out volume over {plan.horizon_s:g} s at {plan.confidence:.1%}"),
        f"Blue: the volume, {1e3 * keep.swept.volume_m3:.3g} litres, shown translucent. White: the target at "
        "the last pair; orange: at the horizon, as predicted.",
    )
    for axes, side in zip(all_axes, sides, strict=True):
        outer = around.orthographic(middle, side.right, side.up, half, SIDE_PX)
        blue = _shade(outer, normal_N, side, VOLUME)
        image, nearest = np.where(outer.hit[..., None], blue, GROUND), np.full(outer.hit.shape, np.inf)
        for k, colour in ((0, NOW), (-1, END)):
            R, p = motion.R_NG[k], motion.p_NG[k]
            view = body.orthographic(R.T @ (middle - p), R.T @ side.right, R.T @ side.up, half, SIDE_PX)
            colours = _shade(view, normal_G @ R.T, side, colour)
            first = view.hit & (np.nan_to_num(view.depth_m, nan=np.inf) < nearest)
            nearest = np.where(first, view.depth_m, nearest)
            veiled = (1.0 - VEIL) * colours + VEIL * np.where(outer.hit[..., None], blue, colours)
            image = np.where(first[..., None], veiled, image)
        _show(axes, image, f"from {side.name} of N", half)
    return png(figure)


@default_style
def draw_speed(plan: Plan, grapples: Sequence[Any]) -> bytes:
    """The mesh from six sides of G by the largest speed over the horizon, the slowest points marked."""
    surface, speed = plan.surface, plan.speed
    assert surface is not None and speed is not None
    viewer, V = MeshViewer(surface.mesh), np.asarray(surface.mesh.vertices)
    normal = np.asarray(surface.mesh.vertex_normals)
    middle = 0.5 * (V.min(axis=0) + V.max(axis=0))
    axes_of_views = np.concatenate([[d.right, d.up] for d in ALONG_AXES])
    half = 1.08 * float(np.abs((V - middle) @ axes_of_views.T).max())
    values = 1e3 * speed.largest_m_s
    top = float(max(values.max(), values.min() + 1e-9))
    scale = ScalarMappable(Normalize(float(values.min()), top), SPEED_MAP)
    figure, all_axes = _page(
        *(2, 3, f"Largest speed of the surface over {plan.horizon_s:g} s"),
        "Numbers: the slowest points that are reachable along their normal, as in planning.json.",
    )
    for axes, side in zip(all_axes, ALONG_AXES, strict=True):
        view = viewer.orthographic(middle, side.right, side.up, half, SIDE_PX)
        light = 0.65 + 0.35 * np.abs(cosine_to_light(view, normal, side))
        colours = np.asarray(scale.to_rgba(view.values(values)))[..., :3] * light[..., None]
        _show(axes, np.where(view.hit[..., None], colours, GROUND), f"from {side.name} of G", half)
        for number, one in enumerate(grapples, start=1):
            _mark(axes, view, side, np.array(one["p_G"]) - middle, half, str(number))
    bar = figure.colorbar(scale, ax=all_axes, shrink=0.8, pad=0.02)
    bar.set_label("largest speed [mm/s]", color=INK)
    return png(figure)


def _mark(axes: Axes, view: MeshView, side: Direction, p: Array, half: float, text: str) -> None:
    """A ring and its number, unless the point is hidden."""
    x, y = p @ side.right, p @ side.up
    u, v = (0.5 * SIDE_PX * (1.0 + float(each) / half) - 0.5 for each in (x, -y))
    row, column = (min(max(round(each), 0), SIDE_PX - 1) for each in (v, u))
    # the depth is measured from the plane through the centre, away from the eye
    depth = view.depth_m[row, column]
    if np.isfinite(depth) and -float(p @ side.eye) > depth + 0.03 * half:
        return
    axes.plot(u, v, "o", markersize=9, markerfacecolor="none", markeredgecolor="white", markeredgewidth=1.6)
    axes.annotate(
        text, (u, v), (7, 5), textcoords="offset points", color="white", size=10, weight="bold",
        path_effects=[withStroke(linewidth=2, foreground=INK)],
    )  # fmt: skip


@default_style
def draw_corridor(plan: Plan) -> bytes:
    """The path of an inspector that stays at the stand-off, in two projections; its acceleration."""
    path, docking = plan.corridor, plan.docking
    assert path is not None and docking is not None
    figure, (above, beside, time) = _page(
        *(1, 3, f"Station keeping at {docking.stand_off_m:g} m in the corridor"),
        "Dots: the inspector, black where it starts; orange: the docking point; grey: the axis. "
        f"{path.delta_v_m_s:.3g} m/s over {plan.horizon_s:g} s.",
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
    return png(figure)


def _shade(view: MeshView, normals: Array, side: Direction, colour: Array) -> Array:
    """(H, W, 3)"""
    return np.asarray(colour * (0.5 + 0.5 * np.abs(cosine_to_light(view, normals, side)))[..., None])


def _page(rows: int, columns: int, title: str, caption: str) -> tuple[Figure, list[Axes]]:
    size_in = (4.3 * columns, 4.3 * rows + 0.9)
    figure = Figure(figsize=size_in, dpi=DPI, facecolor="white", layout="constrained")
    figure.suptitle(title, size=14, weight="bold", color=INK)
    figure.supxlabel(caption, size=9, color=INK)
    return figure, [figure.add_subplot(rows, columns, k + 1) for k in range(rows * columns)]


def _show(axes: Axes, image: Array, title: str, half_m: float) -> None:
    """An orthographic view, with a length instead of ticks."""
    axes.imshow(image, interpolation="nearest")
    axes.set_title(title, size=10, color=INK)
    axes.set_axis_off()
    add_scale_bar(axes, 2e3 * half_m, SIDE_PX)


def plan_folder(path: Path) -> AbstractContextManager[Path]:
    """The folder of the results, links followed; checked before the work, and locked until it is written.

    Raises InputError.
    """
    return marked_folder(path, COMMAND, FILES.__contains__)


def write_plan(plan: Plan, folder: Path) -> list[str]:
    """keepout.ply, keepout.glb, surface_speed.ply, corridor.csv, plan.txt, pictures, planning.json: all or
    none; the names of those written. Raises InputError, RunFailure."""
    files, summary = dict[str, bytes](), summary_of(plan)
    if plan.keep_out is not None:
        for kind in ("ply", "glb"):
            content = plan.keep_out.swept.mesh.export(file_type=kind)
            assert isinstance(content, bytes)
            files[f"keepout.{kind}"] = content
    if plan.speed is not None and plan.surface is not None:
        files["surface_speed.ply"] = speed_ply(plan.surface.mesh, plan.speed)
    if plan.corridor is not None:
        files["corridor.csv"] = corridor_csv(plan.corridor, plan.camera_N).encode()
    if plan.approach is not None:
        files["plan.txt"] = approach_text(plan.approach).encode()
    files |= plan_pictures(plan, summary["surface_speed"]["grapples"] if summary["surface_speed"] else [])
    files["planning.json"] = (json.dumps(summary, indent=1) + "\n").encode()
    write_files(folder, COMMAND, files, FILES.__contains__)
    return list(files)


def speed_ply(mesh: trimesh.Trimesh, speed: SurfaceSpeed) -> bytes:
    """Binary PLY in G: position, normal; current, largest, mean and normal speed, sigma [m/s]."""
    names = ("now_m_s", "largest_m_s", "mean_m_s", "normal_m_s", "sigma_m_s")
    values = np.hstack([mesh.vertices, mesh.vertex_normals]).T
    columns = dict(zip(("x", "y", "z", "nx", "ny", "nz"), values, strict=True))
    columns |= {name.replace("now", "speed"): getattr(speed, name) for name in names}
    vertices = np.zeros(len(mesh.vertices), dtype=[(name, "<f4") for name in columns])
    for name, values in columns.items():
        vertices[name] = values
    faces = np.zeros(len(mesh.faces), dtype=[("count", "u1"), ("index", "<i4", (3,))])
    faces["count"], faces["index"] = 3, mesh.faces
    return binary_ply(vertices, ["frame G, metres, speeds relative to N in m/s"], faces)


VECTORS = ("tip_N", "axis_N", "place_N", "velocity_N", "acceleration_N")
CORRIDOR_COLUMNS = (
    "time_s", *(f"{name}_{a}" for name in VECTORS for a in "xyz"), "camera_angle_deg", "camera_in_cone",
)  # fmt: skip


def corridor_csv(path: Corridor, camera_N: Array | None) -> str:
    """A row for each instant [s, m, m/s, m/s^2, deg, 0 or 1]; the last two are nan without camera_N (3,)."""
    seen = np.full((len(path.time_s), 2), np.nan)
    if camera_N is not None:
        seen = np.column_stack([np.rad2deg(path.angle_rad(camera_N)), path.contains(camera_N)])
    rows = np.column_stack([path.time_s, *(getattr(path, name) for name in VECTORS), seen])
    lines = [",".join(f"{x:.9g}" for x in row) for row in rows]
    return "\n".join([",".join(CORRIDOR_COLUMNS), *lines]) + "\n"


def approach_text(path: ApproachPath) -> str:
    """The camera's poses in N, TUM format, times in seconds after the last pair of the run."""
    what = f"{IN_N} of a camera that looks along z (x right, y down); seconds after the last pair"
    return tum(np.round(1e9 * path.time_s).astype(np.int64), path.X_NR, (what,))


def is_in_N(file: Path) -> bool:
    """Whether a trajectory is one of ``approach_text``, by its first line."""
    try:
        with file.open("rb") as stream:
            return IN_N.encode() in stream.readline(200)
    except OSError:
        # who reads the poses says what is wrong with it
        return False


def summary_of(plan: Plan) -> dict[str, Any]:
    """The content of planning.json: SI units."""
    keep, path, docking, approach = plan.keep_out, plan.corridor, plan.docking, plan.approach
    keepout = corridor = approaching = speed = None
    if keep is not None:
        keepout = {
            "frame": "N",
            "volume_m3": keep.swept.volume_m3,
            "cell_m": keep.swept.level.step_m,
            "sigmas_of_pose": keep.swept.factor,
            "added_m": keep.swept.added_m,
            "sigmas_of_surface": keep.body.sigmas,
            "covers": keep.body.covers,
            "open_share": keep.body.open_share,
            "body_margin_m": _ends(keep.instant.margin_m()),
        }
    if plan.speed is not None and plan.surface is not None:
        speed = _grapples(plan.surface, plan.speed)
    if path is not None and docking is not None:
        acceleration = np.linalg.norm(path.acceleration_N, axis=1)
        corridor = {
            "stand_off_m": docking.stand_off_m,
            "half_angle_deg": docking.half_angle_deg,
            "acceleration_m_s2": {"least": float(acceleration.min()), "largest": float(acceleration.max())},
            "delta_v_m_s": path.delta_v_m_s,
            "isp_s": docking.isp_s,
            "fuel_share": fuel_share(path.delta_v_m_s, docking.isp_s),
            "resting_camera": None if plan.camera_N is None else _in_cone(path, plan.camera_N),
        }
    if approach is not None:
        approaching = {
            "frame": "N",
            "looks_at": "docking point" if docking is not None else "centre of mass",
            "poses": len(approach.time_s),
            "distance_m": _ends(approach.distance_m),
        }
    return {
        "schema": "polhode-planning/1",
        "horizon_s": plan.horizon_s,
        "confidence": plan.confidence,
        "keepout": keepout,
        "surface_speed": speed,
        "corridor": corridor,
        "approach": approaching,
        "left_out": plan.left_out,
        "notes": list(plan.notes),
        "intervals": None if plan.intervals is None else plan.intervals.model_dump(mode="json"),
    }


def _ends(values: Array) -> dict[str, float]:
    return {"start": float(values[0]), "end": float(values[-1])}


def _in_cone(path: Corridor, camera_N: Array) -> dict[str, Any]:
    """When a camera that rests at camera_N (3,) is in the cone: first and last instants of each time [s]."""
    angle_deg = np.rad2deg(path.angle_rad(camera_N))
    inside = np.concatenate([[False], path.contains(camera_N), [False]])
    begins, ends = (np.flatnonzero(np.diff(inside.astype(int)) == sign) for sign in (1, -1))
    nearest = int(np.argmin(angle_deg))
    return {
        "least_angle_deg": float(angle_deg[nearest]),
        "least_angle_at_s": float(path.time_s[nearest]),
        "in_cone_s": np.stack([path.time_s[begins], path.time_s[ends - 1]], axis=1).tolist(),
    }


def _grapples(surface: SurfaceModel, speed: SurfaceSpeed) -> dict[str, Any]:
    """The slowest measured points that are separated from each other and reachable along their normals."""
    mesh = surface.mesh
    p, normal = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    size = float(np.linalg.norm(mesh.extents))
    order = np.argsort(speed.largest_m_s, kind="stable")
    order = order[(surface.views > 0)[order]]
    caster, chosen = Caster(mesh), np.zeros(0, dtype=np.int64)
    for part in np.split(order, range(4000, len(order), 4000)):
        blocked = np.isfinite(caster.first(p[part] + 0.01 * size * normal[part], normal[part])[0])
        both = np.concatenate([chosen, part[~blocked]])
        chosen = both[slowest_points(speed.largest_m_s[both], p[both], MIN_SEPARATION_SHARE * size, GRAPPLES)]
        if len(chosen) == GRAPPLES:
            break
    names = ("now_m_s", "largest_m_s", "normal_m_s", "sigma_m_s")
    return {
        "frame": "G",
        "least_m_s": float(speed.largest_m_s.min()),
        "largest_m_s": float(speed.largest_m_s.max()),
        "grapples": [
            {"p_G": p[n].tolist(), "normal_G": normal[n].tolist()}
            | {name: float(getattr(speed, name)[n]) for name in names}
            for n in chosen
        ],
    }


def format_plan(plan: Plan) -> str:
    """A few lines for the screen."""
    found, lines, over = summary_of(plan), [], f"over {plan.horizon_s:g} s"
    if (keep := found["keepout"]) is not None:
        start, end = (1e3 * keep["body_margin_m"][k] for k in ("start", "end"))
        lines.append(
            f"Keep-out {over} at {plan.confidence:.1%}: {1e3 * keep['volume_m3']:.4g} litres; "
            f"around the body {start:.3g} mm now, {end:.3g} mm at the end"
        )
    if (speed := found["surface_speed"]) is not None:
        lines.append(
            f"The surface moves at {1e3 * speed['least_m_s']:.3g} to {1e3 * speed['largest_m_s']:.3g} mm/s "
            "at most; the slowest points that are reachable along their normal, by their largest speed "
            f"{over} (along the normal: + outwards, now):"
        )
        for one in speed["grapples"]:
            place = " ".join(f"{x:+.3f}" for x in one["p_G"])
            lines.append(
                f"  p_G {place} m: {1e3 * one['now_m_s']:6.1f} ± {1e3 * one['sigma_m_s']:.2g} mm/s now, "
                f"{1e3 * one['largest_m_s']:6.1f} at most, {1e3 * one['normal_m_s']:+6.1f} along the normal"
            )
    if (path := found["corridor"]) is not None:
        least, largest = (1e3 * path["acceleration_m_s2"][k] for k in ("least", "largest"))
        lines.append(
            f"Corridor: {least:.3g} to {largest:.3g} mm/s^2 to stay at {path['stand_off_m']:g} m, "
            f"{path['delta_v_m_s']:.3g} m/s {over}, {path['fuel_share']:.2%} of the mass "
            f"at an Isp of {path['isp_s']:g} s"
        )
        if (camera := path["resting_camera"]) is not None:
            who = "A camera that rests where it was at the last pair is"
            cone, times = f"in the cone of {path['half_angle_deg']:g} deg", camera["in_cone_s"]
            shown = ", ".join(f"from {a:.1f} to {b:.1f} s" for a, b in times[:4])
            more = f", and {len(times) - 4} more times" if len(times) > 4 else ""
            lines.append(
                f"{who} {cone} {shown}{more}"
                if times
                else f"{who} never {cone} {over}: its least angle from the axis is "
                f"{camera['least_angle_deg']:.3g} deg, at {camera['least_angle_at_s']:.1f} s"
            )
    if (approach := found["approach"]) is not None:
        distance = approach["distance_m"]
        lines.append(
            f"Approach (plan.txt, frame N): from {distance['start']:.3g} to {distance['end']:.3g} m from the "
            f"{approach['looks_at']} {over}"
        )
    lines += [f"Left out: {name}: {why}" for name, why in plan.left_out.items()]
    return "\n".join([*lines, *plan.notes])
