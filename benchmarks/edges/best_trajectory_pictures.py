"""Pictures of the ways of `best_trajectory.py`, and what edges contribute halfway along the straight one."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from benchmarks.edges.best_trajectory import DURATION_S, SUN_N, tumbling
from benchmarks.edges.edge_bodies import edge_body
from benchmarks.edges.edge_views import edge_rig
from benchmarks.edges.trajectory.camera_path import camera_poses, sun_in_G, target_centres
from benchmarks.record import Case
from polhode.planning.edges.metric.contributions import contributions
from polhode.planning.edges.metric.edge_motion import DEGREES_OF_FREEDOM
from polhode.planning.edges.metric.information import feature_information
from polhode.planning.edges.metric.pictures import coloured_body, picture
from polhode.planning.edges.model.edge_model import edge_model
from polhode.planning.prediction.ensemble import nominal_motion

UP_N = np.array([0.0, -1.0, 0.0])


def pictures(line: Case, folder: Path) -> None:
    """BODY_ways.png, BODY_contributions.png, and a coloured mesh for each degree of freedom."""
    name = line["case"]["body"]
    mesh, rig = edge_body(name).mesh, edge_rig()
    model, estimate = edge_model(mesh), tumbling(mesh)[0]
    places = {path: np.asarray(p) for path, p in line["places_N"].items()}
    time = np.linspace(0.0, DURATION_S, len(places["straight"]))
    motion = nominal_motion(estimate, time)
    o_N, sun_G = target_centres(model, motion), sun_in_G(motion, SUN_N)
    figure = Figure(figsize=(11.5, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    space = figure.add_subplot(1, 2, 1)
    over_time = figure.add_subplot(1, 2, 2)
    scale = np.array([model.radius_m] * 3 + [1.0] * 3)
    for n, (path, p_N) in enumerate(places.items()):
        X_RG = camera_poses(p_N, o_N, motion, UP_N)
        C = feature_information(model, rig, X_RG, sun_G, clear=True).total * np.outer(scale, scale)
        trace = np.trace(np.linalg.inv(C + np.eye(6)), axis1=1, axis2=2)
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
    figure.savefig(folder / f"{name}_ways.png", dpi=90)
    k = len(time) // 2
    X_RG = camera_poses(places["straight"], o_N, motion, UP_N)[k : k + 1]
    found = contributions(feature_information(model, rig, X_RG))
    picture(model, rig, X_RG[0], found.share).savefig(folder / f"{name}_contributions.png", dpi=70)
    for d, degree in enumerate(DEGREES_OF_FREEDOM):
        body, legend = coloured_body(model, found.share[:, d])
        path = folder / f"{name}_{degree.replace(' ', '_')}.ply"
        body.export(path)
        print(f"{path.name}: shares of the variance from 0 to {legend.values[-1]:.3f}")
