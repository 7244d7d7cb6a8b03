"""Milliseconds a view of the observability metric, and of what is expected of a tracker.

    python -m lab.edges.observability_speed [--short]

Bodies of the simulator, cut into at least 10,000 faces; views from all around. A view is: hidden lines
removed, control points, their motion, C and its inverse; what is expected of a tracker comes on top. Process
time on one core, the least of three rounds; the model of edges is made once.
"""

from time import process_time

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from lab.command import Short, command
from lab.edges.views import KINDS, edge_body
from lab.presentation import print_table
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import make_pose
from polhode.planning.edges.edge_model import edge_model
from polhode.planning.edges.expected_tracking import expected_tracking
from polhode.planning.edges.information import views_along

RIG = RectifiedRig(800.0, 319.5, 239.5, 0.1, 640, 480)
RADII_AWAY = 4.0
ROUNDS, MIN_FACES = 3, 10_000


def main(short: Short = False) -> None:
    """Print the table."""
    names, count = (list(KINDS)[:1], 3) if short else (list(KINDS), 40)
    columns = "body | faces | edges | model [ms] | points | view, median [ms] | slowest"
    print_table(f"{columns} | expected, median [ms] | slowest", (row(name, count) for name in names))


def row(name: str, count: int) -> list[object]:
    """One body."""
    mesh = edge_body(name).mesh
    while len(mesh.faces) < MIN_FACES:
        longest = 0.8 * float(mesh.edges_unique_length.max())
        mesh = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, longest, 20))
    begin = process_time()
    model = edge_model(mesh)
    model_ms = 1e3 * (process_time() - begin)
    R = Rotation.random(count, random_state=0).as_matrix()
    X_RG = make_pose(R, np.array([0.0, 0.0, RADII_AWAY * model.radius_m]) - R @ model.centre_G)
    times, points = np.empty((2, ROUNDS, count)), []
    for n in range(ROUNDS):
        for k in range(count):
            begin = process_time()
            view = next(views_along(model, RIG, X_RG[k : k + 1], model.centre_G))
            _ = view.metric.covariance
            between = process_time()
            _ = expected_tracking(model, RIG, X_RG[k], points=view.points).covariance
            times[:, n, k] = between - begin, process_time() - between
            points.append(len(view.points))
    shown = [f"{f(each):.1f}" for each in 1e3 * times.min(axis=1) for f in (np.median, np.max)]
    return [name, len(mesh.faces), model.size, f"{model_ms:.0f}", f"{np.mean(points):.0f}", *shown]


if __name__ == "__main__":
    command(main)
