"""What ``polhode plan`` writes and prints: meshes, tables, numbers in planning.json, lines for the screen."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from polhode.atomic import write_bytes, write_text
from polhode.lie import Array
from polhode.pipeline.after_run.plan import Plan
from polhode.pipeline.after_run.plan_pictures import plan_pictures
from polhode.planning.approach.corridor import Corridor
from polhode.planning.approach.surface_speed import SurfaceSpeed, slowest_points
from polhode.planning.approach.tumbling_threshold import fuel_share
from polhode.records import SurfaceModel

GRAPPLES = 5
MIN_SEPARATION_SHARE = 0.15
"""Share of the body's size between two grapple points."""


def write_plan(plan: Plan, folder: Path) -> list[str]:
    """keepout.ply, keepout.glb, surface_speed.ply, corridor.csv, pictures, planning.json; the names of those
    written."""
    folder.mkdir(parents=True, exist_ok=True)
    names: list[str] = []
    summary = summary_of(plan)
    if plan.keep_out is not None:
        mesh = plan.keep_out.swept.mesh
        for name in ("keepout.ply", "keepout.glb"):
            write_bytes(folder / name, _bytes(mesh, name))
            names.append(name)
    if plan.speed is not None and plan.surface is not None:
        write_bytes(folder / "surface_speed.ply", speed_ply(plan.surface.mesh, plan.speed))
        names.append("surface_speed.ply")
    if plan.corridor is not None:
        write_text(folder / "corridor.csv", corridor_csv(plan.corridor))
        names.append("corridor.csv")
    grapples = summary["surface_speed"]["grapples"] if summary["surface_speed"] else []
    for name, content in plan_pictures(plan, grapples).items():
        write_bytes(folder / name, content)
        names.append(name)
    write_text(folder / "planning.json", json.dumps(summary, indent=1) + "\n")
    return [*names, "planning.json"]


def _bytes(mesh: trimesh.Trimesh, name: str) -> bytes:
    content = mesh.export(file_type=name.rpartition(".")[2])
    return content if isinstance(content, bytes) else str(content).encode()


def speed_ply(mesh: trimesh.Trimesh, speed: SurfaceSpeed) -> bytes:
    """Binary PLY in G: position, normal; current, largest, mean and normal speed, sigma [m/s]."""
    columns = {
        **{name: np.asarray(mesh.vertices)[:, i] for i, name in enumerate("xyz")},
        **{f"n{name}": np.asarray(mesh.vertex_normals)[:, i] for i, name in enumerate("xyz")},
        "speed_m_s": speed.now_m_s,
        "largest_m_s": speed.largest_m_s,
        "mean_m_s": speed.mean_m_s,
        "normal_m_s": speed.normal_m_s,
        "sigma_m_s": speed.sigma_m_s,
    }
    vertices = np.stack(list(columns.values()), axis=1).astype("<f4")
    faces = np.zeros(len(mesh.faces), dtype=[("count", "u1"), ("index", "<i4", (3,))])
    faces["count"], faces["index"] = 3, mesh.faces
    lines = ["ply", "format binary_little_endian 1.0", "comment frame G, metres, speeds relative to N in m/s"]
    lines += [f"element vertex {len(vertices)}", *(f"property float {name}" for name in columns)]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    return ("\n".join(lines) + "\n").encode("ascii") + vertices.tobytes() + faces.tobytes()


CORRIDOR_COLUMNS = ("time_s", *(f"{name}_{a}" for name in ("tip_N", "axis_N", "place_N", "velocity_N",
                                                            "acceleration_N") for a in "xyz"))  # fmt: skip


def corridor_csv(path: Corridor) -> str:
    """A row for each instant [s, m, m/s, m/s^2]."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(CORRIDOR_COLUMNS)
    parts = (path.tip_N, path.axis_N, path.place_N, path.velocity_N, path.acceleration_N)
    for row in np.concatenate([path.time_s[:, None], *parts], axis=1):
        rows.writerow([f"{x:.9g}" for x in row])
    return text.getvalue()


def summary_of(plan: Plan) -> dict[str, Any]:
    """The content of planning.json: SI units."""
    out: dict[str, Any] = {
        "schema": "polhode-planning/1",
        "horizon_s": plan.horizon_s,
        "confidence": plan.confidence,
        "keepout": None,
        "surface_speed": None,
        "corridor": None,
        "left_out": plan.left_out,
        "notes": list(plan.notes),
    }
    if plan.keep_out is not None:
        found = plan.keep_out
        out["keepout"] = {
            "frame": "N",
            "volume_m3": found.swept.volume_m3,
            "cell_m": found.swept.level.step_m,
            "sigmas_of_pose": found.swept.factor,
            "added_m": found.swept.added_m,
            "sigmas_of_surface": found.body.sigmas,
            "covers": found.body.covers,
            "open_share": found.body.open_share,
            "body_margin_m": {
                "start": float(found.instant.margin_m()[0]),
                "end": float(found.instant.margin_m()[-1]),
            },
        }
    if plan.speed is not None and plan.surface is not None:
        out["surface_speed"] = _grapples(plan.surface, plan.speed)
    if plan.corridor is not None and plan.docking is not None:
        acceleration = np.linalg.norm(plan.corridor.acceleration_N, axis=1)
        out["corridor"] = {
            "stand_off_m": plan.docking.stand_off_m,
            "half_angle_deg": plan.docking.half_angle_deg,
            "acceleration_m_s2": {"least": float(acceleration.min()), "largest": float(acceleration.max())},
            "delta_v_m_s": plan.corridor.delta_v_m_s,
            "isp_s": plan.docking.isp_s,
            "fuel_share": fuel_share(plan.corridor.delta_v_m_s, plan.docking.isp_s),
        }
    return out


def _grapples(surface: SurfaceModel, speed: SurfaceSpeed) -> dict[str, Any]:
    """The slowest measured points that are separated from each other and reachable along their normals."""
    mesh = surface.mesh
    p, normal = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    size = float(np.linalg.norm(mesh.extents))
    order = np.argsort(speed.largest_m_s, kind="stable")
    order = order[(surface.views > 0)[order]]
    chosen: list[int] = []
    for start in range(0, len(order), 4000):
        part = order[start : start + 4000]
        free = part[_reachable(mesh, p[part], normal[part], size)]
        both = np.concatenate([np.array(chosen, dtype=np.int64), free])
        chosen = [
            int(both[k])
            for k in slowest_points(speed.largest_m_s[both], p[both], MIN_SEPARATION_SHARE * size, GRAPPLES)
        ]
        if len(chosen) == GRAPPLES:
            break
    return {
        "frame": "G",
        "least_m_s": float(speed.largest_m_s.min()),
        "largest_m_s": float(speed.largest_m_s.max()),
        "grapples": [
            {
                "p_G": p[n].tolist(),
                "normal_G": normal[n].tolist(),
                "now_m_s": float(speed.now_m_s[n]),
                "largest_m_s": float(speed.largest_m_s[n]),
                "normal_m_s": float(speed.normal_m_s[n]),
                "sigma_m_s": float(speed.sigma_m_s[n]),
            }
            for n in chosen
        ],
    }


def _reachable(mesh: trimesh.Trimesh, p: Array, normal: Array, size: float) -> Array:
    from polhode.mapping.visibility import Caster

    distance, _ = Caster(mesh).first(p + 0.01 * size * normal, normal)
    return ~np.isfinite(distance)


def format_plan(plan: Plan) -> str:
    """A few lines for the screen."""
    found, lines = summary_of(plan), []
    if (keep := found["keepout"]) is not None:
        lines.append(
            f"Keep-out over {plan.horizon_s:g} s at {plan.confidence:.1%}: "
            f"{1e3 * keep['volume_m3']:.4g} litres; "
            f"around the body {1e3 * keep['body_margin_m']['start']:.3g} mm now, "
            f"{1e3 * keep['body_margin_m']['end']:.3g} mm at the end"
        )
    if (speed := found["surface_speed"]) is not None:
        lines.append(
            f"The surface moves at {1e3 * speed['least_m_s']:.3g} to "
            f"{1e3 * speed['largest_m_s']:.3g} mm/s at most; "
            "slowest points that are reachable along their normal:"
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
            f"{path['delta_v_m_s']:.3g} m/s over the horizon, {path['fuel_share']:.2%} of the mass "
            f"at {path['isp_s']:g} s"
        )
    lines += [f"Left out: {name}: {why}" for name, why in plan.left_out.items()]
    return "\n".join([*lines, *plan.notes])
