"""Does the keep-out volume of a simulated sequence hold the true body on its true way?

    python -m benchmarks.planning.keepout_truth RUN... [--data DATA...] [--horizon 60] [--record FILE]

The dataset of a run is data/NAME of its folder's name, unless given. Points sampled on the true mesh move
along the true motion after the last pair. Those that no frame saw in light are counted on their own: the
promise is for what was measured and what it encloses. One sequence is one draw: it shows errors of the
surface and of the motion that the covariances do not know, not a frequency.
"""

import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from benchmarks.command import Record, Runs, Workers, command
from benchmarks.planning.keepout import Cover
from benchmarks.record import Case, complete

RECORD = Path("runs/keepout_truth.jsonl")
POINTS, INSTANTS = 20_000, 120
FEW_POINTS, FEW_INSTANTS = 4_000, 20
"""For the volume at each instant, whose distances take longer."""


def main(
    runs: Runs,
    data: Annotated[tuple[Path, ...], arg(help="Sequences, one for each run.")] = (),
    horizon: Annotated[float, arg(help="Seconds ahead.")] = 60.0,
    confidence: float = 0.99,
    cover: Cover = "auto",
    workers: Workers = 1,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the table."""
    folders = data or [Path("data") / run.name for run in runs]
    if len(folders) != len(runs):
        raise SystemExit(f"--data: {len(folders)} for {len(runs)} runs")
    cases: list[Case] = [
        {
            "run": os.fspath(run),
            "data": os.fspath(folder),
            "horizon_s": horizon,
            "confidence": confidence,
            "cover": cover,
        }
        for run, folder in zip(runs, folders, strict=True)
    ]
    print(table(complete(record, cases, measure, workers)))


def measure(case: Case) -> dict[str, Any]:
    """One run."""
    from polhode.dataset import open_sequence
    from polhode.mesh_metrics import distance_to_surface, sample_surface
    from polhode.metrics import truth_at
    from polhode.pipeline.after_run.plan import final_estimate, surface_of
    from polhode.pipeline.evaluation import seen_and_lit
    from polhode.pipeline.run_directory.trajectory_file import read_trajectory, target_poses
    from polhode.planning.keep_out.volumes import KeepOutOptions, keep_out
    from polhode.planning.prediction import nominal_motion
    from polhode.truth import read_truth

    run, data = Path(case["run"]), Path(case["data"])
    estimate, _ = final_estimate(run)
    surface = surface_of(run)
    found = keep_out(
        surface, estimate, KeepOutOptions(case["horizon_s"], case["confidence"], cover=case["cover"])
    )
    truth, stamps = read_truth(data), read_trajectory(run).timestamps_ns
    if truth.mesh is None:
        raise SystemExit(f"{data}: the truth has no mesh")
    points, normals = sample_surface(truth.mesh, POINTS)
    X_frames = target_poses(truth_at(truth, stamps), truth.R_GP, truth.com_G)
    seen = seen_and_lit(truth.mesh, points, normals, X_frames, open_sequence(data), 1)

    motion = found.instant.motion
    rows = np.unique(np.linspace(0, len(motion.time_s) - 1, INSTANTS).round().astype(int))
    at = stamps[-1] + np.round(motion.time_s[rows] * 1e9).astype(np.int64)
    X_NG = target_poses(truth_at(truth, at), truth.R_GP, truth.com_G)
    out = np.full(len(points), -np.inf)
    for X in X_NG:
        out = np.maximum(out, found.swept.signed_distance(points @ X[:3, :3].T + X[:3, 3]))
    few, few_seen = points[:: POINTS // FEW_POINTS], seen[:: POINTS // FEW_POINTS]
    out_instant = np.full(len(few), -np.inf)
    for i in np.unique(np.linspace(0, len(rows) - 1, FEW_INSTANTS).round().astype(int)):
        places = few @ X_NG[i, :3, :3].T + X_NG[i, :3, 3]
        out_instant = np.maximum(out_instant, found.instant.signed_distance(int(rows[i]), places))
    # how far the mesh is from what comes out: a part that it lacks, or an error of the surface?
    X_end = nominal_motion(estimate, np.array([0.0, 1.0])).X_NG[0]
    X_last = target_poses(truth_at(truth, stamps[-1:]), truth.R_GP, truth.com_G)[0]
    places = few @ X_last[:3, :3].T + X_last[:3, 3]
    p_G = (places - X_end[:3, 3]) @ X_end[:3, :3]
    came_out = out_instant > 0.0
    least = distance_to_surface(surface.mesh, p_G[came_out]).min() if came_out.any() else None
    return {
        "covers": found.body.covers,
        "least_from_mesh_m": None if least is None else float(least),
        "seen": float(seen.mean()),
        **_numbers("swept", out, seen),
        **_numbers("instant", out_instant, few_seen),
    }


def _numbers(name: str, out_m: np.ndarray, seen: np.ndarray) -> dict[str, Any]:
    """Shares inside at all instants, and the farthest that a point comes out [m]."""
    parts = {"seen": out_m[seen], "unseen": out_m[~seen]}
    return {
        f"{name}_{part}": {
            "inside": float((values <= 0.0).mean()) if len(values) else None,
            "farthest_m": float(max(values.max(), 0.0)) if len(values) else None,
        }
        for part, values in parts.items()
    }


def table(lines: list[Case]) -> str:
    """Markdown; a share and how far the farthest point comes out."""
    rows = [
        "| run | covers | true surface seen | seen, over the horizon | seen, at each instant "
        "| never seen, over the horizon | never seen, at each instant "
        "| error of the mesh where points are outside |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for line in lines:
        cells = [
            "-" if part["inside"] is None else f"{part['inside']:.2%}, {1e3 * part['farthest_m']:.2f} mm"
            for part in (
                line[f"{volume}_{kind}"] for kind in ("seen", "unseen") for volume in ("swept", "instant")
            )
        ]
        name = Path(line["case"]["run"]).name
        least = line["least_from_mesh_m"]
        cells.append("-" if least is None else f"at least {1e3 * least:.1f} mm")
        rows.append(f"| {name} | {line['covers']} | {line['seen']:.1%} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


if __name__ == "__main__":
    command(main)
