"""The files of ``polhode plan``: meshes, tables, numbers in planning.json, pictures; lines for the screen.

No picture is a result: if one cannot be made, there is a warning.
"""

import io
import json
import logging
import re
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from matplotlib.figure import Figure
from numpy.typing import NDArray

from polhode.files.output.marked_folder import marked_folder, write_files
from polhode.files.ply import binary_ply
from polhode.geometry.lie import Array
from polhode.mapping.visibility import Caster, MeshView, MeshViewer
from polhode.planning.approach.corridor import Corridor
from polhode.planning.approach.surface_speed import SurfaceSpeed, slowest_points
from polhode.planning.approach.tumbling_threshold import fuel_share
from polhode.planning.exports.ccsds import tum
from polhode.planning.keep_out.measured_body import REASONS, ScalarGrid
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
from polhode.report.plot_style import INK
from polhode.runtime.drawing_style import default_style

IN_N = "X_NR: poses in N"
"""How the first line of a planned trajectory begins, after "#"."""

COMMAND = "plan"
FILES = (
    "keepout.ply", "keepout.glb", "keepout.npz", "keepout.png", "surface_speed.ply", "corridor.csv",
    "plan.txt", "planning.json",
)  # fmt: skip
REASON_RGB = ((69, 115, 184), (214, 126, 44), (150, 150, 150))
"""Colours of what was measured, seen in outlines, not excluded"""


def is_plan_file(name: str) -> bool:
    """Whether the command writes a file of this name; those of an earlier call that this one does not write
    are removed.
    """
    return name in FILES or re.fullmatch(r"keepout_\d{3,4}\.(ply|glb)", name) is not None


SIDE_PX = 340

_log = logging.getLogger(__name__)


@default_style
def draw_keepout(plan: Plan) -> bytes:
    """The volume in N from four sides, with the body at the last pair and at the horizon seen through it."""
    keep, surface = plan.keep_out, plan.surface
    assert keep is not None and surface is not None
    volume, motion = keep.swept.mesh, keep.instant.motion
    by_reason = np.array(REASON_RGB)[keep.swept_reasons] / 255.0
    around, body = MeshViewer(volume), MeshViewer(surface.mesh)
    normal_G, normal_N = np.asarray(surface.mesh.vertex_normals), np.asarray(volume.vertex_normals)
    middle = volume.bounds.mean(axis=0)
    sides = (ALONG_AXES[2], ALONG_AXES[0], ALONG_AXES[1], OBLIQUE[0])
    corners = np.asarray(volume.vertices) - middle
    half = 1.05 * max(float(np.abs(corners @ np.stack([d.right, d.up]).T).max()) for d in sides)
    figure = Figure(figsize=(8.6, 9.5), dpi=DPI, facecolor="white", layout="constrained")
    title = f"Keep-out volume over {plan.horizon_s:g} s at {100.0 * plan.confidence:g} %"
    figure.suptitle(title, size=14, weight="bold", color=INK)
    figure.supxlabel(
        f"The volume, {volume_in_words(keep.swept.volume_m3)}, shown translucent: blue where the body was "
        "measured, orange where\noutlines show it, grey where no frame excludes it. White: the target at the "
        "last pair; red: at the horizon.",
        size=9,
        color=INK,
    )

    def shaded(view: MeshView, normals: Array, side: Direction, rgb: Array) -> Array:
        return np.asarray(rgb * (0.5 + 0.5 * np.abs(cosine_to_light(view, normals, side)))[..., None])

    for number, side in enumerate(sides, start=1):
        outer = around.orthographic(middle, side.right, side.up, half, SIDE_PX)
        veil = shaded(outer, normal_N, side, outer.values(by_reason))
        image, nearest = np.where(outer.hit[..., None], veil, GROUND), np.full(outer.hit.shape, np.inf)
        for k, rgb in ((0, (0.93, 0.93, 0.90)), (-1, (0.80, 0.30, 0.28))):
            R, p = motion.R_NG[k], motion.p_NG[k]
            view = body.orthographic(R.T @ (middle - p), R.T @ side.right, R.T @ side.up, half, SIDE_PX)
            colours = shaded(view, normal_G @ R.T, side, np.array(rgb))
            first = view.hit & (np.nan_to_num(view.depth_m, nan=np.inf) < nearest)
            nearest = np.where(first, view.depth_m, nearest)
            # the volume veils the body
            veiled = 0.65 * colours + 0.35 * np.where(outer.hit[..., None], veil, colours)
            image = np.where(first[..., None], veiled, image)
        axes = figure.add_subplot(2, 2, number)
        axes.imshow(image, interpolation="nearest")
        axes.set_title(f"from {side.name} of N", size=10, color=INK)
        axes.set_axis_off()
        add_scale_bar(axes, 2e3 * half, SIDE_PX)
    return png(figure)


def plan_folder(path: Path) -> AbstractContextManager[Path]:
    """The folder of the results, links followed; checked before the work, and locked until it is written.

    Raises InputError.
    """
    return marked_folder(path, COMMAND, is_plan_file)


def write_plan(plan: Plan, folder: Path) -> list[str]:
    """Volumes, surface speeds, corridor, path, pictures and planning.json: all or none; the names of those
    written. Raises InputError, RunFailure.
    """
    files, summary = dict[str, bytes](), summary_of(plan)
    if (keep := plan.keep_out) is not None:
        files |= volume_files("keepout", keep.swept.mesh, keep.swept_reasons)
        files["keepout.npz"] = field_npz(keep.swept.field())
        for number, time_s in enumerate(plan.instants_s):
            mesh = keep.instant.level(time_s).mesh()
            reason = keep.reasons(np.asarray(mesh.vertices, dtype=np.float64), time_s)
            files |= volume_files(f"keepout_{number:03d}", mesh, reason, time_s)
    if plan.speed is not None and plan.surface is not None:
        files["surface_speed.ply"] = speed_ply(plan.surface.mesh, plan.speed)
    if plan.corridor is not None:
        files["corridor.csv"] = corridor_csv(plan.corridor).encode()
    if plan.approach is not None:
        what = f"{IN_N} of a camera that looks along z (x right, y down); seconds after the last pair"
        times = np.round(1e9 * plan.approach.time_s).astype(np.int64)
        files["plan.txt"] = tum(times, plan.approach.X_NR, (what,)).encode()
    if plan.keep_out is not None:
        try:
            files["keepout.png"] = draw_keepout(plan)
        except Exception as error:  # noqa: BLE001  a picture is no result: the plan goes on without it
            _log.warning("no picture: keepout.png (%s: %s)", type(error).__name__, error)
    files["planning.json"] = (json.dumps(summary, indent=1) + "\n").encode()
    write_files(folder, COMMAND, files, is_plan_file)
    return list(files)


def volume_files(
    name: str, mesh: trimesh.Trimesh, reason: NDArray[np.uint8], time_s: float | None = None
) -> dict[str, bytes]:
    """PLY and GLB of a volume in N, coloured by why each vertex is there (V,), which the PLY has, too."""
    rgb = np.array(REASON_RGB, dtype=np.uint8)[reason]
    columns = dict(zip("xyz", np.asarray(mesh.vertices).T, strict=True))
    columns |= dict(zip(("nx", "ny", "nz"), np.asarray(mesh.vertex_normals).T, strict=True))
    vertices = np.zeros(
        len(rgb),
        dtype=[*((n, "<f4") for n in columns), *((n, "u1") for n in ("red", "green", "blue", "reason"))],
    )
    for key, values in columns.items():
        vertices[key] = values
    for key, values in zip(("red", "green", "blue"), rgb.T, strict=True):
        vertices[key] = values
    vertices["reason"] = reason
    words = ", ".join(f"{n} {each}" for n, each in enumerate(REASONS))
    at = "" if time_s is None else f", {time_s:g} s after the last pair"
    ply = binary_ply(vertices, [f"frame N, metres{at}; reason: {words}"], triangles(mesh))
    coloured = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=rgb, process=False)
    glb = coloured.export(file_type="glb")
    assert isinstance(glb, bytes)
    return {f"{name}.ply": ply, f"{name}.glb": glb}


def field_npz(field: ScalarGrid) -> bytes:
    """The signed distance from the swept volume at the corners of a grid: origin_N, step_m, distance_m."""
    content = io.BytesIO()
    np.savez_compressed(content, origin_N=field.origin, step_m=field.step_m, distance_m=field.values)
    return content.getvalue()


def triangles(mesh: trimesh.Trimesh) -> NDArray[np.void]:
    """The faces as ``binary_ply`` takes them."""
    faces = np.zeros(len(mesh.faces), dtype=[("count", "u1"), ("index", "<i4", (3,))])
    faces["count"], faces["index"] = 3, mesh.faces
    return faces


def speed_ply(mesh: trimesh.Trimesh, speed: SurfaceSpeed) -> bytes:
    """Binary PLY in G: position, normal; current, largest, mean and normal speed, sigma [m/s]."""
    names = ("now_m_s", "largest_m_s", "mean_m_s", "normal_m_s", "sigma_m_s")
    values = np.hstack([mesh.vertices, mesh.vertex_normals]).T
    columns = dict(zip(("x", "y", "z", "nx", "ny", "nz"), values, strict=True))
    columns |= {name.replace("now", "speed"): getattr(speed, name) for name in names}
    vertices = np.zeros(len(mesh.vertices), dtype=[(name, "<f4") for name in columns])
    for name, values in columns.items():
        vertices[name] = values
    return binary_ply(vertices, ["frame G, metres, speeds relative to N in m/s"], triangles(mesh))


def volume_in_words(volume_m3: float) -> str:
    """Litres, or cubic metres from one on."""
    return f"{1e3 * volume_m3:.4g} litres" if volume_m3 < 1.0 else f"{volume_m3:.4g} m^3"


VECTORS = ("tip_N", "axis_N", "place_N", "velocity_N", "acceleration_N")
CORRIDOR_COLUMNS = ("time_s", *(f"{name}_{a}" for name in VECTORS for a in "xyz"))


def corridor_csv(path: Corridor) -> str:
    """A row for each instant [s, m, m/s, m/s^2]."""
    rows = np.column_stack([path.time_s, *(getattr(path, name) for name in VECTORS)])
    lines = [",".join(f"{x:.9g}" for x in row) for row in rows]
    return "\n".join([",".join(CORRIDOR_COLUMNS), *lines]) + "\n"


def is_in_N(file: Path) -> bool:
    """Whether a trajectory is the plan.txt of a plan, by its first line."""
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
            "sigma_added_m": keep.swept.sigma_added_m,
            "members": keep.members,
            "sigmas_of_surface": keep.body.sigmas,
            "covers": keep.body.covers,
            "open_share": keep.body.open_share,
            "body_margin_m": _ends(keep.instant.margin_m()),
            "instants_s": list(plan.instants_s),
        }
    if plan.speed is not None and plan.surface is not None:
        speed = _grapples(plan.surface, plan.speed)
    if path is not None and docking is not None:
        acceleration = np.linalg.norm(path.acceleration_N, axis=1)
        corridor = {
            "stand_off_m": docking.stand_off_m,
            "acceleration_m_s2": {"least": float(acceleration.min()), "largest": float(acceleration.max())},
            "delta_v_m_s": path.delta_v_m_s,
            "isp_s": docking.isp_s,
            "fuel_share": fuel_share(path.delta_v_m_s, docking.isp_s),
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


def _grapples(surface: SurfaceModel, speed: SurfaceSpeed) -> dict[str, Any]:
    """The five slowest measured points reachable along their normals, 15 % of the body's size apart."""
    mesh = surface.mesh
    p, normal = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    size = float(np.linalg.norm(mesh.extents))
    order = np.argsort(speed.largest_m_s, kind="stable")
    order = order[(surface.views > 0)[order]]
    caster, chosen = Caster(mesh), np.zeros(0, dtype=np.int64)
    for part in np.split(order, range(4000, len(order), 4000)):
        blocked = np.isfinite(caster.first(p[part] + 0.01 * size * normal[part], normal[part])[0])
        both = np.concatenate([chosen, part[~blocked]])
        chosen = both[slowest_points(speed.largest_m_s[both], p[both], 0.15 * size, 5)]
        if len(chosen) == 5:
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
            f"Keep-out {over} at {100.0 * plan.confidence:g} %: {volume_in_words(keep['volume_m3'])}; "
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
    if (approach := found["approach"]) is not None:
        distance = approach["distance_m"]
        lines.append(
            f"Approach (plan.txt, frame N): from {distance['start']:.3g} to {distance['end']:.3g} m from the "
            f"{approach['looks_at']} {over}"
        )
    lines += [f"Left out: {name}: {why}" for name, why in plan.left_out.items()]
    return "\n".join([*lines, *plan.notes])
