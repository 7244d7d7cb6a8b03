"""Does the keep-out volume hold its probability: Monte Carlo over the uncertainty of a run, or the true body.

    python -m benchmarks.planning.keepout RUN... [--horizon 60] [--draws 400] [--short] [--record FILE]
    python -m benchmarks.planning.keepout RUN... --truth [--data DATA...] [--horizon 60]

Without ``--truth``: truths are sampled from the run's joint covariance, with disturbances of the level that
it found, by other seeds than those that the volume was calibrated with; each point of the surface is off by
its own sigma, independently. A draw counts as inside when all of its surface stays inside at all instants.
The smallest sufficient volume is at least that of a single draw's own sweep: the volume is compared with the
estimate's, without any margin, so the ratio is an upper bound. Where the volume is for the convex hull, as
nothing is known of the open parts of the mesh, the smallest sufficient one holds the hull: the second ratio
is against the bare sweep of what is covered. The third one counts the pose as well: any volume that holds 99
% of the draws holds each cell that more than 1 % of them sweep, so those cells bound the smallest volume for
these draws from below. They are counted with 200 draws of pose and surface, on a grid of twice the step. A
point's sigma is the one that planning takes, limited by those of its neighbours and their distance; in the
column "spiky" each vertex is off by the sigma of the mesh alone, whatever its neighbours do.

With ``--truth``: points sampled on the true mesh of a simulated sequence move along the true motion after the
last pair. The dataset of a run is data/NAME of its folder's name, unless given. Points that no frame saw in
light are counted separately: the volume is for what was measured and what it encloses. One sequence is one
draw: it shows errors of the surface and of the motion that the covariances do not contain, not a frequency.
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from tyro.conf import arg

from benchmarks.command import Record, Runs, Workers, command
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from polhode.pipeline.after_run.keep_out_truth import Excess, keep_out_truth
from polhode.pipeline.after_run.plan import final_estimate, surface_of
from polhode.planning.keep_out.distance_fields import FAR, protrusion, protrusion_at_instants, sweep
from polhode.planning.keep_out.measured_body import Cover, continuous_sigma, grown_body, thinned_vertices
from polhode.planning.keep_out.volumes import KeepOutOptions, fine_times, keep_out, points_near_surface
from polhode.planning.prediction import draw_ensemble, nominal_motion
from polhode.records import SurfaceModel

RECORD, TRUTH_RECORD = Path("runs/records/keepout"), Path("runs/records/keepout_truth")
BARE_SIGMA_M = 1e-9
NEEDED_DRAWS, NEEDED_CELLS = 200, 40
POINTS_APART_M = 0.5
"""Of a cell of the volume: points of the surface that are looked at."""


def main(
    runs: Runs,
    truth: Annotated[bool, arg(help="The true body of simulated sequences instead of draws.")] = False,
    data: Annotated[tuple[Path, ...], arg(help="Sequences, one for each run, with --truth.")] = (),
    horizon: Annotated[tuple[float, ...], arg(help="Seconds ahead.")] = (60.0,),
    confidence: float = 0.99,
    draws: Annotated[int, arg(help="Sampled truths.")] = 400,
    cover: Cover = "auto",
    workers: Workers = 1,
    short: Annotated[bool, arg(help="10 s ahead, 200 draws.")] = False,
    record: Record | None = None,
) -> None:
    """Measure what the record lacks, print the table."""
    horizons, count = ((10.0,), 200) if short else (horizon, draws)
    folders = data or [Path("data") / run.name for run in runs]
    if len(folders) != len(runs):
        raise SystemExit(f"--data: {len(folders)} for {len(runs)} runs")
    cases: list[Case] = []
    for run, folder in zip(runs, folders, strict=True):
        for seconds in horizons:
            case: Case = {"run": os.fspath(run), "horizon_s": seconds, "confidence": confidence}
            if truth:
                cases.append(case | {"data": os.fspath(folder), "cover": cover})
            else:
                cases.append(case | {"draws": count} | ({} if cover == "auto" else {"cover": cover}))
    if truth:
        print_truth(complete(record or TRUTH_RECORD, cases, measure_truth, workers))
    else:
        print_draws(complete(record or RECORD, cases, measure, workers))


def measure(case: Case) -> dict[str, Any]:
    """One run, one horizon."""

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
    index = cKDTree(V).query(kept)[1]
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


def measure_truth(case: Case) -> dict[str, Any]:
    """One run, against its true body."""

    run, data = Path(case["run"]), Path(case["data"])
    estimate, _ = final_estimate(run)
    surface = surface_of(run)
    found = keep_out(
        surface, estimate, KeepOutOptions(case["horizon_s"], case["confidence"], cover=case["cover"])
    )
    truth = keep_out_truth(found, surface, run, data)
    return {
        "covers": found.body.covers,
        "least_from_mesh_m": truth.least_from_mesh_m,
        "seen": float(truth.swept.seen.mean()),
        **_numbers("swept", truth.swept),
        **_numbers("instant", truth.instant),
    }


def _numbers(name: str, excess: Excess) -> dict[str, Any]:
    """Shares inside at all instants, and the farthest that a point comes out [m]."""
    return {
        f"{name}_{part}": {"inside": excess.inside(chosen), "farthest_m": excess.farthest_m(chosen)}
        for part, chosen in (("seen", excess.seen), ("unseen", ~excess.seen))
    }


def print_draws(lines: list[Case]) -> None:
    """Shares of the draws, and volumes."""
    head = (
        "run | horizon [s] | confidence | draws inside, whole horizon | the same, spiky "
        "| inside at each instant | volume [l] | over the bare sweep of the surface "
        "| over the bare sweep of what is covered | over the cells that the draws need | covers"
    )
    print_table(head, map(_row, lines))


def _row(line: Case) -> Iterator[object]:
    case = line["case"]
    n = case["draws"]
    yield from (Path(case["run"]).name, f"{case['horizon_s']:g}", f"{case['confidence']:.0%}")
    for count in ("inside", "inside_stated", "inside_instants"):
        yield f"{line[count]} of {n} ({line[count] / n:.1%})"
    yield f"{1e3 * line['volume_m3']:.2f}"
    for least in ("least_m3", "least_covered_m3", "needed_m3"):
        yield f"{line['volume_m3'] / line[least]:.3f}"
    yield line["covers"]


def print_truth(lines: list[Case]) -> None:
    """Shares, and how far the farthest point comes out."""
    head = (
        "run | covers | true surface seen | seen, over the horizon | seen, at each instant "
        "| never seen, over the horizon | never seen, at each instant "
        "| error of the mesh where points are outside"
    )
    print_table(head, map(_truth_row, lines))


def _truth_row(line: Case) -> Iterator[object]:
    yield from (Path(line["case"]["run"]).name, line["covers"], f"{line['seen']:.1%}")
    for kind in ("seen", "unseen"):
        for volume in ("swept", "instant"):
            part = line[f"{volume}_{kind}"]
            inside = part["inside"]
            yield "-" if inside is None else f"{inside:.2%}, {1e3 * part['farthest_m']:.2f} mm"
    least = line["least_from_mesh_m"]
    yield "-" if least is None else f"at least {1e3 * least:.1f} mm"


if __name__ == "__main__":
    command(main)
