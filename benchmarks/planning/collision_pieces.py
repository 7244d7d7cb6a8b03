"""Convex pieces of an export: how far they reach beyond the mesh of a run, and how far the mesh beyond them.

    python -m benchmarks.planning.collision_pieces RUN... [--pieces 32 128 512] [--peer coacd]

``--peer coacd`` adds the pieces of CoACD (Wei et al., "Approximate convex decomposition for 3D meshes with
collision-aware concavity and tree search", 2022; pip install coacd) with the same limit on their number, as
they are and, "grown", after the step that gives ours their containment. "Mesh outside": the share of the
mesh's area that lies outside all pieces by more than rounding, and how far at most.
"""

import time
from collections.abc import Callable, Sequence
from typing import Annotated, Literal

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from tyro.conf import arg

from benchmarks.command import Runs, command
from polhode.lie import Array
from polhode.pipeline.after_run.plan import surface_of
from polhode.planning.exports.convex_pieces import (
    CUT_FACES,
    MAX_PROTRUSION_SHARE,
    ROUNDING_SHARE,
    OutwardDistance,
    _beyond,
    _grown_pieces,
    _hull,
    decompose,
    outside,
)
from polhode.planning.exports.records import ExportShape, Placement, shape_of_surface

SAMPLES = 50_000


def main(
    runs: Runs,
    pieces: Annotated[tuple[int, ...], arg(help="Limits on the number of pieces.")] = (32, 128, 512),
    peer: Annotated[Literal["coacd"] | None, arg(help="Also the pieces of CoACD.")] = None,
) -> None:
    """A row for each run, number and method."""
    methods: dict[str, Callable[[ExportShape, int], Sequence[trimesh.Trimesh]]] = {"ours": _ours}
    if peer:
        methods |= {"CoACD": _coacd, "CoACD, grown": _coacd_grown}
    print(
        "| run | method | at most | pieces | 95 % of the area within [mm] | farthest [mm] | of the diameter "
        f"| area beyond {MAX_PROTRUSION_SHARE:.0%} | mesh outside | farthest [mm] | CPU [s] |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|"
    )
    for run in runs:
        shape = shape_of_surface(surface_of(run), Placement("G", np.eye(4), ""))
        reach = OutwardDistance(shape.mesh())
        corners = shape.mesh().convex_hull.vertices
        diameter = float(max(np.linalg.norm(corners - each, axis=1).max() for each in corners))
        for most in pieces:
            for name, method in methods.items():
                start = time.process_time()
                found = tuple(method(shape, most))
                spent = time.process_time() - start
                beyond = _beyond(found, reach)
                lost = _outside_all(shape, found)
                print(
                    f"| {run.name} | {name} | {most} | {len(found)} | {1e3 * np.quantile(beyond, 0.95):.2f} "
                    f"| {1e3 * beyond.max():.2f} | {beyond.max() / diameter:.2%} "
                    f"| {np.mean(beyond > MAX_PROTRUSION_SHARE * diameter):.3%} "
                    f"| {np.mean(lost > 1e-6 * diameter):.2%} | {1e3 * lost.max():.2f} | {spent:.0f} |",
                    flush=True,
                )


def _ours(shape: ExportShape, most: int) -> Sequence[trimesh.Trimesh]:
    return decompose(shape, most).pieces


def _coacd(shape: ExportShape, most: int) -> Sequence[trimesh.Trimesh]:
    import coacd

    coacd.set_log_level("error")
    mesh = shape.mesh()
    if len(mesh.faces) > CUT_FACES:
        mesh = mesh.simplify_quadric_decimation(face_count=CUT_FACES)
    parts = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), max_convex_hull=most)
    return [trimesh.Trimesh(vertices, faces, process=False).convex_hull for vertices, faces in parts]


def _coacd_grown(shape: ExportShape, most: int) -> Sequence[trimesh.Trimesh]:
    reach = OutwardDistance(shape.mesh())
    seeds = [np.asarray(piece.vertices) for piece in _coacd(shape, most)]
    return [
        _hull(piece.corners, ROUNDING_SHARE * reach.size_m) for piece in _grown_pieces(shape, seeds, reach)
    ]


def _outside_all(shape: ExportShape, pieces: Sequence[trimesh.Trimesh]) -> Array:
    """Of points on the mesh, how far they are outside of the nearest piece [m]; 0 inside."""
    points = np.asarray(trimesh.sample.sample_surface(shape.mesh(), SAMPLES, seed=0)[0])
    nearest = np.full(len(points), np.inf)
    for piece in pieces:
        nearest = np.minimum(nearest, outside(points, ConvexHull(np.asarray(piece.vertices)).equations))
    return np.maximum(nearest, 0.0)


if __name__ == "__main__":
    command(main)
