"""How far the convex pieces of an export reach beyond the mesh of a run, by how many there may be.

python -m benchmarks.planning.collision_pieces RUN... [--pieces 32 128 512]
"""

import argparse
import time
from pathlib import Path

from polhode.pipeline.products.plan import surface_of
from polhode.planning.exports.convex import WITHIN, decompose
from polhode.planning.exports.frames import frame_G
from polhode.planning.exports.records import shape_of_surface


def main() -> None:
    """A row for each run and number."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--pieces", type=int, nargs="+", default=[32, 128, 512])
    options = parser.parse_args()
    print(
        "| run | at most | pieces | 95 % of the area within [mm] | farthest [mm] | of the diameter "
        f"| area beyond {WITHIN:.0%} | CPU [s] |\n|---|---|---|---|---|---|---|---|"
    )
    for run in options.runs:
        shape = shape_of_surface(surface_of(run), frame_G())
        for most in options.pieces:
            start = time.process_time()
            found = decompose(shape, most)
            spent = time.process_time() - start
            print(
                f"| {run.name} | {most} | {len(found.pieces)} | {1e3 * found.beyond_m:.2f} "
                f"| {1e3 * found.most_beyond_m:.2f} | {found.most_beyond_m / found.diameter_m:.2%} "
                f"| {found.far_share:.3%} | {spent:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
