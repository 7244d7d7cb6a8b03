"""Does the keep-out volume hold its probability: Monte Carlo over the uncertainty of a run.

    python -m lab.planning.keepout RUN... [--horizon 60] [--draws 400]

Truths are sampled from the run's joint covariance, with disturbances of the level that it found, by other
seeds than those that the volume was calibrated with; each point of the surface is off by its own sigma, as
planning takes it, independently. A draw counts as inside when all of its surface stays inside at all
instants. The volume is compared with the sweep of the estimate without any margin, of the measured surface
and of all that is covered; the smallest sufficient volume is at least the latter.
``lab.missions.keep_out`` takes true bodies of simulated missions instead.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from tyro.conf import arg

from lab.command import Runs, command
from lab.presentation import print_table
from polhode.planning.keep_out.distance_fields import FAR, outermost_pairs, protrusion, sweep
from polhode.planning.keep_out.measured_body import Cover, continuous_sigma, grown_body, thinned_vertices
from polhode.planning.keep_out.volumes import PARTS_OF_HORIZON, KeepOutOptions, fine_times, keep_out
from polhode.planning.plan import final_estimate, surface_of
from polhode.planning.prediction import draw_ensemble, nominal_motion
from polhode.records.surface import SurfaceModel
from polhode.run_directory.archives import read_occupancy

BARE_SIGMA_M = 1e-9
"""Of a surface without a margin."""
POINTS_APART_CELLS = 0.5
"""Points of the surface that are looked at, in cells of the volume."""
DRAWS = (
    "run | horizon [s] | confidence | draws inside, whole horizon | volume [l] | over the bare sweep of the "
    "surface | over the bare sweep of what is covered | covers"
)


def main(
    runs: Runs,
    horizon: Annotated[float, arg(help="Seconds ahead.")] = 60.0,
    draws: Annotated[int, arg(help="Sampled truths.")] = 400,
    cells: Annotated[int, arg(help="Cells along the longest side of the volume.")] = 72,
) -> None:
    """Measure and print the table."""
    options = KeepOutOptions(horizon, 0.99, cells=cells)
    print_table(DRAWS, (draws_row(run, options, draws) for run in runs))


def draws_row(run: Path, options: KeepOutOptions, draws: int) -> list[object]:
    """One run against truths that are drawn."""
    estimate, _ = final_estimate(run)
    surface, occupied = surface_of(run), read_occupancy(run)
    found = keep_out(surface, estimate, options, occupied)
    level, motion = found.swept.level, found.instant.motion
    # the sweep of the bare estimate
    bare = SurfaceModel(surface.mesh, np.full(len(surface.sigma_m), BARE_SIGMA_M), surface.views)

    def bare_sweep(cover: Cover) -> NDArray[np.float32]:
        body = grown_body(bare, 0.5, cover=cover, occupied=occupied)
        step_m = np.full(len(motion.time_s), level.step_m)
        fine = fine_times(motion, body.radius_m, step_m, options.horizon_s)
        states = nominal_motion(estimate, fine)
        field = np.full((*level.values.shape, 1), FAR, dtype=np.float32)
        sweep(
            field, level.origin, level.step_m, np.zeros(1), states.R_NG, states.p_NG,
            np.zeros((len(fine), 6, 6)), body.grid.values, body.grid.origin, body.grid.step_m,
            body.centre_G, body.radius_m,
        )  # fmt: skip
        return np.asarray(field[..., 0])

    covers = found.body.covers
    field = bare_sweep("surface")
    covered = bare_sweep(covers) if covers != "surface" else field
    cells = float((level.values <= 0.0).sum())
    # truths: poses by other seeds, every point of the surface off by its own sigma
    members = draw_ensemble(estimate, motion.time_s, draws, 1000)
    V, N = np.asarray(surface.mesh.vertices), np.asarray(surface.mesh.vertex_normals)
    # what lies within a cell of the surface stands for the rest: of each place the point that is farthest out
    kept = thinned_vertices(trimesh.Trimesh(V, process=False), POINTS_APART_CELLS * level.step_m)
    index = cKDTree(V).query(kept)[1]
    sigma_m, rng = continuous_sigma(surface)[index], np.random.default_rng(2000)
    band_m = np.full(len(motion.time_s), 0.02 + level.step_m)
    pairs = outermost_pairs(
        np.ascontiguousarray(field), level.origin, level.step_m, np.ascontiguousarray(motion.R_NG),
        np.ascontiguousarray(motion.p_NG), kept, band_m, PARTS_OF_HORIZON,
    )  # fmt: skip
    fields, inside = np.ascontiguousarray(level.values[..., None]), 0
    for n in range(draws):
        points = kept + (sigma_m * rng.normal(size=len(index)))[:, None] * N[index]
        part = members.part(slice(n, n + 1))
        out_m = protrusion(fields, level.origin, level.step_m, part.R_NG, part.p_NG, pairs, points)
        inside += int(out_m[0, 0] <= 0.0)
    return [
        run.name,
        f"{options.horizon_s:g}",
        f"{options.confidence:.0%}",
        f"{inside} of {draws} ({inside / draws:.1%})",
        f"{1e3 * cells * level.step_m**3:.2f}",
        *(f"{cells / float((each <= 0.0).sum()):.3f}" for each in (field, covered)),
        covers,
    ]


if __name__ == "__main__":
    command(main)
