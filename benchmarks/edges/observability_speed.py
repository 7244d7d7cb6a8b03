"""Seconds a view of the observability metric, over bodies and numbers of faces.

    python -m benchmarks.edges.observability_speed [--short]

Bodies of the simulator and solids, cut into smaller faces where they have fewer than asked; views from all
around. A view is: hidden lines removed, control points, their motion, C and its inverse; what is expected of
a tracker comes on top. Process time on one core, the least of three rounds; the model of edges is made once.
The limit is 50 ms for 10,000 faces. The
pictures are those of the command for six views, the coloured body included; their limit is 3 s. The rough
sphere is as photogrammetry might give it: most of its edges are sharp.
"""

from time import process_time
from typing import Annotated

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation
from tyro.conf import arg

from benchmarks.command import Short, command
from benchmarks.edges.views import KINDS, edge_body
from benchmarks.presentation import print_table
from polhode.camera import RectifiedRig
from polhode.lie import Array, make_pose
from polhode.pipeline.after_run.observability.assess import Subject, assess
from polhode.pipeline.after_run.observability.pictures import (
    VIEWS,
    coloured_body,
    draw_contributions,
    draw_metric,
    draw_views,
)
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.expected_tracking import expected_tracking
from polhode.planning.edges.information import views_along
from polhode.planning.edges.visible_edges import SPACING_PX
from polhode.progress import Silent

RIG = RectifiedRig(800.0, 319.5, 239.5, 0.1, 640, 480)
DIAMETERS_AWAY = 2.0
ROUNDS = 3
NOISE_M = 0.006
"""Of the vertices of the rough sphere, whose radius is 0.5 m"""


def main(
    faces: Annotated[int, arg(help="Fewest faces of a body.")] = 10_000,
    short: Short = False,
) -> None:
    """Print the table."""
    count = 5 if short else 40
    bodies = {name: edge_body(name).mesh for name in (list(KINDS)[:1] if short else KINDS)}
    bodies["torus"] = trimesh.creation.torus(0.5, 0.15, 120, 60)
    bodies["rough sphere"] = rough_sphere(faces)
    columns = "model [ms] | points per view | view, median [ms] | slowest [ms]"
    columns += " | expected of a tracker, median [ms] | slowest [ms] | pictures [s]"
    head = f"body | faces | edges | {columns}"
    print_table(head, (row(name, finer(mesh, faces), count) for name, mesh in bodies.items()))


def row(name: str, mesh: trimesh.Trimesh, count: int) -> list[object]:
    """One body."""
    start = process_time()
    model = edge_model(mesh)
    made = process_time() - start
    X_RG = camera_poses_around(model.centre_G, 2.0 * DIAMETERS_AWAY * model.radius_m, count)
    times, points = np.full((2, ROUNDS, count), np.inf), []
    for n in range(ROUNDS):
        for k in range(count):
            start = process_time()
            view = next(views_along(model, RIG, X_RG[k : k + 1], model.centre_G))
            _ = view.metric.covariance
            between = process_time()
            _ = expected_tracking(model, RIG, X_RG[k], points=view.points).covariance
            times[:, n, k] = between - start, process_time() - between
            points.append(len(view.points))
    metric, expected = 1e3 * times.min(axis=1)
    sizes = (len(mesh.faces), model.size, f"{1e3 * made:.0f}", f"{np.mean(points):.0f}")
    shown = (f"{each:.1f}" for each in (np.median(metric), metric.max(), np.median(expected), expected.max()))
    return [name, *sizes, *shown, f"{pictures_s(model, X_RG):.1f}"]


def pictures_s(model: EdgeModel, X_RG: Array) -> float:
    """Process time of all pictures of up to six views, the least of three rounds."""
    chosen = X_RG[:VIEWS]
    time_s, o_G = np.arange(float(len(chosen))), model.centre_G
    subject = Subject("a body", model, RIG, time_s, chosen, "its centre", o_G, None, model.notes)
    assessment = assess(subject, SPACING_PX, 1.0, None, False, Silent())
    values = np.nan_to_num(assessment.edges.share).max(axis=1)
    times = []
    for _ in range(ROUNDS):
        start = process_time()
        draw_metric(assessment)
        draw_views(assessment)
        draw_contributions(assessment, 0)
        coloured_body(model, values)
        times.append(process_time() - start)
    return min(times)


def rough_sphere(faces: int) -> trimesh.Trimesh:
    """A sphere with at least so many faces and noise of its vertices."""
    count = int(np.ceil(np.sqrt(faces / 4.0))) + 1
    sphere = trimesh.creation.uv_sphere(0.5, count=[count, count])
    noise = np.random.default_rng(0).normal(size=sphere.vertices.shape)
    return trimesh.Trimesh(sphere.vertices + NOISE_M * noise, sphere.faces, process=False)


def camera_poses_around(centre_G: Array, distance_m: float, count: int) -> Array:
    """Poses X_RG (count, 4, 4) from all around, the middle on the optical axis."""
    R = Rotation.random(count, random_state=0).as_matrix()
    return make_pose(R, np.array([0.0, 0.0, distance_m]) - R @ centre_G)


def finer(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """The mesh with at least so many faces: the longest edges are cut."""
    longest = float(mesh.edges_unique_length.max())
    while len(mesh.faces) < faces:
        longest *= 0.8
        vertices, cut = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, longest, max_iter=20)
        mesh = trimesh.Trimesh(vertices, cut, process=False)
    return mesh


if __name__ == "__main__":
    command(main)
