"""Does the keep-out volume keep its promise: Monte Carlo over what a run does not know of its target.

    python -m benchmarks.planning.keepout RUN... [--horizon 60] [--draws 400] [--short] [--record FILE]

The truth is drawn from the run's joint covariance, with disturbances of the level that it found, by other
seeds than those that the volume was calibrated with; each point of its surface is off by its own sigma,
independently. A draw counts as inside when all of its surface stays inside at all instants. The smallest
volume that would do is at least that of a single draw's own sweep: the volume is set against the estimate's,
without any margin, so the ratio is an upper bound. Where the promise is for the convex hull, as nothing
tells what the open mesh lacks, the smallest that would do holds the hull: the second ratio is against the
bare sweep of what is covered. The third one counts the pose as well: whatever holds 99 % of the draws holds
each cell that more than 1 % of them sweep, so those cells bound the smallest volume for these draws from
below. They are counted with 200 draws of pose and surface, on a grid of twice the step.

A point's sigma is that which planning takes, no larger than a neighbour's and the way to it; the column
"spiky" has each vertex off by the sigma of the mesh alone, whatever its neighbours do. What was measured
before is read from the record.
"""

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from tyro.conf import arg

from benchmarks.command import Record, Runs, Workers, command
from benchmarks.record import Case, complete

Cover = Literal["auto", "surface", "hull"]
RECORD = Path("runs/keepout.jsonl")
BARE_SIGMA_M = 1e-9
NEEDED_DRAWS, NEEDED_CELLS = 200, 40
POINTS_APART_M = 0.5
"""Of a cell of the volume: points of the surface that are looked at."""


def main(
    runs: Runs,
    horizon: Annotated[tuple[float, ...], arg(help="Seconds ahead.")] = (60.0,),
    confidence: float = 0.99,
    draws: Annotated[int, arg(help="Truths that are drawn.")] = 400,
    cover: Cover = "auto",
    workers: Workers = 1,
    short: Annotated[bool, arg(help="10 s ahead, 200 draws.")] = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the table."""
    horizons, count = ((10.0,), 200) if short else (horizon, draws)
    cases: list[Case] = [
        {"run": os.fspath(run), "horizon_s": h, "confidence": confidence, "draws": count}
        for run in runs
        for h in horizons
    ]
    if cover != "auto":
        cases = [{**case, "cover": cover} for case in cases]
    print(table(complete(record, cases, measure, workers)))


def measure(case: Case) -> dict[str, Any]:
    """One run, one horizon."""
    import trimesh

    from polhode.pipeline.after_run.plan import final_estimate, surface_of
    from polhode.planning.keep_out.distance_fields import FAR, protrusion, protrusion_at_instants, sweep
    from polhode.planning.keep_out.measured_body import Cover, continuous_sigma, grown_body, thinned_vertices
    from polhode.planning.keep_out.volumes import KeepOutOptions, fine_times, keep_out, points_near_surface
    from polhode.planning.prediction import draw_ensemble, nominal_motion
    from polhode.records import SurfaceModel

    run = Path(case["run"])
    estimate, _ = final_estimate(run)
    surface = surface_of(run)
    wanted = KeepOutOptions(case["horizon_s"], case["confidence"], cover=case.get("cover", "auto"))
    found = keep_out(surface, estimate, wanted)
    level, motion = found.swept.level, found.instant.motion
    V, N = np.asarray(surface.mesh.vertices), np.asarray(surface.mesh.vertex_normals)
    taken = continuous_sigma(surface)
    # the sweep of the bare estimate
    bare = SurfaceModel(surface.mesh, np.full(len(surface.sigma_m), BARE_SIGMA_M), surface.views)

    def needed_m3(cover: Cover) -> float:
        """Of the cells that more draws sweep than may be missed; poses and surfaces drawn."""
        few, rng = draw_ensemble(estimate, motion.time_s, NEEDED_DRAWS, 3000), np.random.default_rng(4000)
        step, shape = 2.0 * level.step_m, tuple((n + 1) // 2 for n in level.values.shape)
        times, none = len(motion.time_s), np.zeros(len(motion.time_s))
        count = np.zeros(shape, dtype=np.int64)
        for n in range(NEEDED_DRAWS):
            off = taken * rng.normal(size=len(V))
            drawn = trimesh.Trimesh(V + off[:, None] * N, surface.mesh.faces, process=False)
            body = grown_body(replace(bare, mesh=drawn), 0.5, cells=NEEDED_CELLS, cover=cover)
            # without what the grid cannot resolve
            values = body.grid.values + np.float32(body.pad_m)
            field = np.full((*shape, 1), FAR, dtype=np.float32)
            sweep(
                field, level.origin, step, np.zeros(1), few.R_NG[n], few.p_NG[n], np.zeros((times, 6, 6)),
                none, values, body.grid.origin, body.grid.step_m, body.centre_G, body.radius_m,
            )  # fmt: skip
            count += field[..., 0] <= 0.0
        return float((count > (1.0 - case["confidence"]) * NEEDED_DRAWS).sum()) * step**3

    def bare_sweep(cover: Cover) -> NDArray[np.float32]:
        body = grown_body(bare, 0.5, cover=cover)
        fine = fine_times(motion, body.radius_m, level.step_m, wanted.horizon_s)
        states = nominal_motion(estimate, fine)
        field = np.full((*level.values.shape, 1), FAR, dtype=np.float32)
        sweep(
            field, level.origin, level.step_m, np.zeros(1), states.R_NG, states.p_NG,
            np.zeros((len(fine), 6, 6)), np.zeros(len(fine)), body.grid.values, body.grid.origin,
            body.grid.step_m, body.centre_G, body.radius_m,
        )  # fmt: skip
        return np.asarray(field[..., 0])

    field = bare_sweep("surface")
    least = float((field <= 0.0).sum()) * level.step_m**3
    min_covered = least
    if found.body.covers == "hull":
        min_covered = float((bare_sweep("hull") <= 0.0).sum()) * level.step_m**3
    ours = float((level.values <= 0.0).sum()) * level.step_m**3
    # truths: poses by other seeds, every point of the surface off by its own sigma
    members = draw_ensemble(estimate, motion.time_s, case["draws"], 1000)
    # what lies within a cell of the surface stands for the rest: of each place the point that is farthest out
    kept = thinned_vertices(trimesh.Trimesh(V, process=False), POINTS_APART_M * level.step_m)
    index = _rows_of(V, kept)
    sigma = taken[index]
    stated = np.where(np.isfinite(surface.sigma_m), surface.sigma_m, 0.0)[index]
    band = np.full(len(motion.time_s), 0.02 + level.step_m)
    pairs = points_near_surface(field, level.origin, level.step_m, motion, kept, band)
    rng = np.random.default_rng(2000)
    fields = np.ascontiguousarray(level.values[..., None])
    inside = inside_stated = inside_instants = 0
    chosen = np.unique(np.linspace(0, len(motion.time_s) - 1, 40).round().astype(int))
    for n in range(case["draws"]):
        normal = rng.normal(size=len(index))
        points = kept + (sigma * normal)[:, None] * N[index]
        spiky = kept + (stated * normal)[:, None] * N[index]
        part = members.part(slice(n, n + 1))
        inside, inside_stated = (
            total
            + int(
                protrusion(fields, level.origin, level.step_m, part.R_NG, part.p_NG, pairs, each)[0, 0] <= 0.0
            )
            for total, each in ((inside, points), (inside_stated, spiky))
        )
        few = points[:: max(1, len(points) // 2000)]
        instant = protrusion_at_instants(
            np.array([found.instant.factor]), np.ascontiguousarray(part.R_NG[:, chosen]),
            np.ascontiguousarray(part.p_NG[:, chosen]), motion.R_NG[chosen], motion.p_NG[chosen],
            found.instant.covariance[chosen], found.body.grid.values, found.body.grid.origin,
            found.body.grid.step_m, few,
        )  # fmt: skip
        inside_instants += instant[0, 0] <= found.instant.added_m
    return {
        "inside": inside,
        "inside_stated": inside_stated,
        "inside_instants": int(inside_instants), "volume_m3": ours, "least_m3": least,
        "least_covered_m3": min_covered,
        "needed_m3": needed_m3(found.body.covers),
        "points": len(kept), "cell_m": level.step_m, "factor": found.swept.factor,
        "added_m": found.swept.added_m,
        "covers": found.body.covers,
    }  # fmt: skip


def _rows_of(V: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(V).query(chosen)[1])


def table(lines: list[Case]) -> str:
    """Markdown."""
    rows = [
        "| run | horizon [s] | confidence | draws inside, whole horizon | the same, spiky "
        "| inside at each instant | volume [l] "
        "| over the bare sweep of the surface | over the bare sweep of what is covered "
        "| over the cells that the draws need "
        "| covers |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for line in lines:
        case = line["case"]
        n = case["draws"]
        rows.append(
            f"| {Path(case['run']).name} | {case['horizon_s']:g} | {case['confidence']:.0%} "
            f"| {line['inside']} of {n} ({line['inside'] / n:.1%}) "
            f"| {line['inside_stated']} of {n} ({line['inside_stated'] / n:.1%}) "
            f"| {line['inside_instants']} of {n} ({line['inside_instants'] / n:.1%}) "
            f"| {1e3 * line['volume_m3']:.2f} | {line['volume_m3'] / line['least_m3']:.3f} "
            f"| {line['volume_m3'] / line['least_covered_m3']:.3f} "
            f"| {line['volume_m3'] / line['needed_m3']:.3f} "
            f"| {line['covers']} |"
        )
    return "\n".join(rows)


if __name__ == "__main__":
    command(main)
