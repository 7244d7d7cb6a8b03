"""Trajectories and sets of edges chosen by the metric, tried on images: do they give better poses?

    python -m benchmarks.edges.best_trajectory [BODY ...] [--short] [--record FILE] [--pictures DIR]

A body tumbles; a camera starts 4 m away and approaches to where the body just fills the image, in 60 s, in
sunlight with black shadows. There are three trajectories: the straight one; the best one with the range of
the straight one at each step, so that only the direction is chosen; the best one with any range. Along each,
images with noise are made at even times, and each is tracked on its own from a guess with a known error. On
the images of the straight trajectory the tracker then uses fewer edges: those chosen by the metric along that
trajectory, the longest, random ones.

Errors are translations of the body's centre along the camera's axes, and rotations. A pose with an error
beyond CONVERGED (radii, radians) did not converge; root mean squares are of the others. The metric is the
root of tr (I + C)^-1, translations in radii, for one pixel: its root mean square over the trajectory, which
was minimised, and its median, beside root mean square and median of the measured errors, in thousandths of a
radius and millirad.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from matplotlib.collections import PolyCollection
from tyro.conf import Positional, arg

from benchmarks.command import Record, Short, Workers, command
from benchmarks.edges.tracking.tracker import track
from benchmarks.edges.trajectory_optimization import (
    CameraPathTask,
    best_trajectory,
    camera_poses,
    min_range,
    path_metric,
    sun_in_G,
    table_for,
    target_centres,
    trace_of_inverse,
)
from benchmarks.edges.views import EdgeViews, ViewOptions, edge_body, edge_rig, perturbed
from benchmarks.presentation import numbers, print_table, save_figure, subplots
from benchmarks.record import Case, complete
from polhode.pipeline.after_run.observability.pictures import coloured_body, picture
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.information import contributions, feature_information
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM, motion_scale, pose_error
from polhode.planning.edges.selection import edge_lengths, greedy, improved_by_exchange
from polhode.planning.edges.smallest_set import smallest_set
from polhode.planning.keep_out.volumes import InstantKeepOut, KeepOutOptions, keep_out
from polhode.planning.prediction import FinalEstimate, FinalState, nominal_motion
from polhode.records import SurfaceModel

RECORD = Path("runs/records/best_trajectory")
BODIES = ("steps", "satellite")
CONVERGED = 0.03
DURATION_S, STEPS = 60.0, 12
START_N, SUN_N = np.array([0.0, 0.0, -4.0]), np.array([0.8, -0.3, -0.6])
RATE_G = np.array([0.02, 0.03, 0.05])
TURNS_DEG = (70.0,)
"""Of the guesses"""
RANDOM_SETS = 2
BUDGET = 0.35
"""Share of the edges that are ever seen"""


def main(
    bodies: Positional[tuple[str, ...]] = BODIES,
    images: Annotated[int, arg(help="Images along each trajectory.")] = 24,
    short: Short = False,
    workers: Workers = 1,
    record: Record = RECORD,
    pictures: Annotated[
        Path | None, arg(help="Folder for pictures of the trajectories and of what edges contribute.")
    ] = None,
) -> None:
    """Measure what the record lacks, print the tables."""
    count = 12 if short else images
    cases: list[Case] = [{"body": body, "images": count} for body in bodies]
    lines = complete(record, cases, measure, workers)
    show(lines, "ways", "trajectory")
    print()
    show(lines, "sets", "edges")
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
        for line in lines:
            draw_pictures(line, pictures)


def measure(case: Case) -> dict[str, Any]:
    """One body."""

    target, rig = edge_body(case["body"]), edge_rig()
    model = edge_model(target.mesh)
    estimate = tumbling(target.mesh)
    volume = volume_of(target.mesh, estimate)
    ranges_m = (min_range(model, rig) + 0.02, 4.3)
    task = CameraPathTask(START_N, DURATION_S, STEPS, 0.01, ranges_m, 0.15, 0.1, sun_N=SUN_N)
    table = table_for(model, rig, estimate, task)
    same_range, free = (
        best_trajectory(
            model, rig, estimate, volume, replace(task, fixed_range=fixed), TURNS_DEG, table=table
        )
        for fixed in (True, False)
    )
    paths = {
        "straight": same_range.straight_path,
        "best at the same range": same_range.best,
        "best": path_metric(model, rig, estimate, task, free.best.path),
    }
    trials = {name: Trial(target, rig, seen, case["images"]) for name, seen in paths.items()}
    out: dict[str, Any] = {
        "ways": [
            {
                "name": name,
                **metric(paths[name].C, model.radius_m),
                "delta_v_m_s": paths[name].path.delta_v_m_s,
                **trial.errors(model),
            }
            for name, trial in trials.items()
        ],
        "places_N": {name: seen.p_N.tolist() for name, seen in paths.items()},
        "starts": [same_range.starts, same_range.tried, free.starts, free.tried],
        "gap_m": [same_range.gap_m, free.gap_m],
    }
    out["sets"] = edge_sets(model, rig, paths["straight"], trials["straight"])
    return out


def tumbling(mesh: Any, rate_G: Any = RATE_G, R_NG: Any = None) -> FinalEstimate:
    """The motion of a body with small covariances about its centre.

    ``rate_G`` (3,): of rotation at the start [rad/s]. ``R_NG`` (3, 3): attitude there; None: aligned with N.
    """

    basis = np.zeros((5, 3, 3))
    for n, (i, j) in enumerate([(0, 0), (1, 1), (0, 1), (0, 2), (1, 2)]):
        basis[n, i, j] = basis[n, j, i] = 1.0
    sigma = np.concatenate([np.repeat([1e-3, 1e-4, 5e-3, 2e-4], 3), np.full(5, 1e-3), np.full(3, 5e-4)])
    last = FinalState(
        np.zeros(3), np.zeros(3), np.eye(3) if R_NG is None else R_NG, rate_G, np.diag([1.3, 1.0, 0.8]),
        np.eye(3), basis, np.diag(sigma**2),
    )  # fmt: skip
    return FinalEstimate(last, np.mean(mesh.bounds, axis=0), 0.0, 0.0)


def volume_of(mesh: Any, estimate: FinalEstimate) -> InstantKeepOut:
    """The keep-out volume of a tumbling body at each instant of the approach."""
    fine = mesh.subdivide_to_size(0.05)
    count = len(fine.vertices)
    surface = SurfaceModel(fine, np.full(count, 1e-3), np.full(count, 5, dtype=np.int64))
    return keep_out(surface, estimate, KeepOutOptions(DURATION_S, 0.97, members=120, cells=32)).instant


class Trial:
    """Images along a path."""

    def __init__(self, target: Any, rig: Any, seen: Any, images: int) -> None:
        """At even times, with independent noise."""

        self.rig = rig
        rows = np.linspace(0, len(seen.time_s) - 1, images).round().astype(int)
        self.X_RG, self.sun_R = seen.X_RG[rows], seen.sun_R[rows]
        self.images = EdgeViews(target, rig, 3, ViewOptions(earth=0.0)).images(self.X_RG, self.sun_R)

    def errors(self, model: Any) -> dict[str, Any]:
        """Root mean squares (6,) [m, rad] of the poses that converged, and the share of those."""

        start = perturbed(self.X_RG, model.centre_G, seed=4)
        e, converged = np.zeros((len(start), 6)), np.zeros(len(start), dtype=bool)
        scale = motion_scale(model.radius_m)
        for k, (image, guess) in enumerate(zip(self.images, start, strict=True)):
            found = track(model, self.rig, np.asarray(image, dtype=np.float64), guess)
            e[k] = pose_error(found.X_RG, self.X_RG[k], model.centre_G)
            converged[k] = found.converged and float(np.linalg.norm(e[k] / scale)) < CONVERGED
        return {
            "rms": np.sqrt(np.mean(e[converged] ** 2, axis=0)).tolist()
            if converged.any()
            else [float("nan")] * 6,
            "median": float(np.median(np.linalg.norm(e / scale, axis=1))),
            "all": float(np.sqrt(np.mean(np.sum((e[converged] / scale) ** 2, axis=1)))),
            "home": float(converged.mean()),
        }


def edge_sets(model: Any, rig: Any, seen: Any, trial: Trial) -> list[dict[str, Any]]:
    """All edges, the smallest set within 10 %, and sets of one size."""

    sun_G = np.einsum("tji,tj->ti", seen.X_RG[:, :3, :3], seen.sun_R)
    information = feature_information(model, rig, seen.X_RG, sun_G, clear=True)
    A = information.scaled
    candidates = np.flatnonzero((A.trace(axis1=2, axis2=3) > 0.0).any(axis=0))
    few = smallest_set(information)
    budget = max(6, round(BUDGET * len(candidates)))
    chosen = improved_by_exchange(A, greedy(A, budget, "trace"), budget, "trace")
    by_information = greedy(A, budget, "log_det")
    longest = candidates[np.argsort(-edge_lengths(model)[candidates], kind="stable")][:budget]
    rng = np.random.default_rng(5)
    random = [rng.choice(candidates, budget, replace=False) for _ in range(RANDOM_SETS)]
    sets = [
        ("all visible", candidates),
        (f"fewest within 10 % (at least {few.at_least})", few.features),
        ("chosen by the trace", chosen.features),
        ("chosen by log det", by_information.features),
        ("longest", longest),
        *((f"random {n + 1}", one) for n, one in enumerate(random)),
    ]
    return [
        {
            "name": name,
            "count": len(features),
            **metric(information.C[:, features].sum(axis=1), model.radius_m),
            **trial.errors(model.only(np.asarray(features))),
        }
        for name, features in sets
    ]


def metric(C: Any, radius_m: float) -> dict[str, float]:
    """Root mean square and median over views (F, 6, 6)."""
    scale = motion_scale(radius_m)
    trace = trace_of_inverse(C * np.outer(scale, scale))
    return {"metric": float(np.sqrt(trace.mean())), "metric_median": float(np.sqrt(np.median(trace)))}


def show(lines: list[Case], key: str, what: str) -> None:
    """Print a row for each trajectory, or set of edges."""
    head = ["body", what, "metric", "its median", "converged", "error", "its median"]
    head += [f"{c} [mm]" for c in "xyz"] + [f"about {c} [mrad]" for c in "xyz"]
    rows = [
        [
            line["case"]["body"],
            one["name"] + (f", {one['count']}" if "count" in one else ""),
            *(f"{1e3 * one[value]:.2f}" for value in ("metric", "metric_median")),
            f"{one['home']:.0%}",
            *numbers(1e3 * np.array([one["all"], one["median"], *one["rms"]]), ".2f"),
        ]
        for line in lines
        for one in line[key]
    ]
    print_table(head, rows, right_from=2)


UP_N = np.array([0.0, -1.0, 0.0])


def draw_pictures(line: Case, folder: Path) -> None:
    """BODY_ways.png, BODY_contributions.png, and a coloured mesh for each degree of freedom."""
    name = line["case"]["body"]
    mesh, rig = edge_body(name).mesh, edge_rig()
    model, estimate = edge_model(mesh), tumbling(mesh)
    places = {path: np.asarray(p) for path, p in line["places_N"].items()}
    time = np.linspace(0.0, DURATION_S, len(places["straight"]))
    motion = nominal_motion(estimate, time)
    o_N, sun_G = target_centres(model, motion), sun_in_G(motion, SUN_N)
    figure, (space, over_time) = subplots(1, 2, (11.5, 4.4), layout="constrained")
    for n, (path, p_N) in enumerate(places.items()):
        X_RG = camera_poses(p_N, o_N, motion, UP_N)
        trace = trace_of_inverse(feature_information(model, rig, X_RG, sun_G, clear=True).scaled.sum(axis=1))
        space.plot(*p_N[:, [0, 2]].T, color=f"C{n}", label=path)
        space.plot(*p_N[-1, [0, 2]], "o", color=f"C{n}")
        over_time.semilogy(time, 1e3 * np.sqrt(trace), color=f"C{n}", label=path)
    corners = np.asarray(mesh.vertices) @ motion.R_NG[-1].T + motion.p_NG[-1]
    shadows = list(corners[np.asarray(mesh.faces)][:, :, [0, 2]])
    space.add_collection(PolyCollection(shadows, facecolor="0.75", edgecolor="none"))
    sun = SUN_N[[0, 2]] / np.linalg.norm(SUN_N)
    space.annotate("Sun", 1.6 * sun, 0.9 * sun, arrowprops={"arrowstyle": "->", "color": "orange"})
    space.set(xlabel="x in N [m]", ylabel="z in N [m]", aspect="equal", title=f"{name}, seen along -y")
    space.grid(alpha=0.3)
    over_time.set(xlabel="time [s]", ylabel="root of tr (I + C)^-1, thousandths for one pixel")
    over_time.legend(fontsize=8)
    over_time.grid(alpha=0.3)
    save_figure(figure, folder / f"{name}_ways.png", 90)
    k = len(time) // 2
    X_RG = camera_poses(places["straight"], o_N, motion, UP_N)[k : k + 1]
    found = contributions(feature_information(model, rig, X_RG))
    picture(model, rig, X_RG[0], found.share).savefig(folder / f"{name}_contributions.png", dpi=70)
    for d, degree in enumerate(DEGREES_OF_FREEDOM):
        body, legend = coloured_body(model, found.share[:, d])
        path = folder / f"{name}_{degree.replace(' ', '_')}.ply"
        body.export(path)
        print(f"{path.name}: shares of the variance from 0 to {legend.values[-1]:.3f}")


if __name__ == "__main__":
    command(main)
