"""Poses that the edge tracker finds in rendered images of a flight.

The tracker starts near the true pose, as from a filter that is well, or far from it, as from one that is not.
The same start serves all filters: their differences are then those of the weights alone. Shadows are black.
"""

from pathlib import Path

import numpy as np

from benchmarks.edge_bodies import edge_body
from benchmarks.edge_views import EdgeViews, ViewOptions
from benchmarks.found_pose import FoundPose, spread
from benchmarks.navigation_scene import Flight, sun_R
from planning.observability.edge_model import EdgeModel
from planning.observability.edge_motion import moved
from planning.observability.tracker import Tracked, track
from polhode.camera import RectifiedRig
from polhode.dataset_writer import write_png
from polhode.images import Grey, read_raw
from polhode.lie import Array

NEAR = np.repeat([0.01, np.deg2rad(1.0)], 3)
"""Sigma of a usual start [m, rad]."""
FAR = np.repeat([0.06, np.deg2rad(6.0)], 3)
"""Of a bad one."""


def tracked_poses(
    course: Flight, body: str, model: EdgeModel, rig: RectifiedRig, seed: int, folder: Path
) -> tuple[list[FoundPose | None], list[FoundPose | None]]:
    """At each instant the pose from a usual start, and from a bad one; None where the tracker gives none.

    Images are kept in ``folder``.
    """
    views = EdgeViews(edge_body(body, plain=True), rig, seed, ViewOptions(earth=0.0))
    rng = np.random.default_rng([seed, 0x7AC4])
    usual: list[FoundPose | None] = []
    bad: list[FoundPose | None] = []
    for k in range(len(course.states)):
        X_RG = course.X_RG(k)
        image = _image(views, X_RG, sun_R(course.R_NR[k]), k, folder)
        for sigma, poses in (NEAR, usual), (FAR, bad):
            start = moved(X_RG, sigma * rng.standard_normal(6), model.middle_G)
            tracked = track(model, rig, image.astype(np.float64), start)
            poses.append(_found(tracked, model.radius_m) if tracked.converged else None)
    return usual, bad


def _image(views: EdgeViews, X_RG: Array, sun: Array, k: int, folder: Path) -> Grey:
    path = folder / f"{k:03}.png"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_png(path, views.image(X_RG, sun, k))
    return np.asarray(read_raw(path, views.rig.width_px, views.rig.height_px), dtype=np.uint8)


def _found(tracked: Tracked, radius_m: float) -> FoundPose | None:
    """What records keep of it."""
    used = tracked.robust > 0.0
    if used.sum() < 7:
        return None
    weight = (tracked.robust * tracked.points.weight)[used]
    _, by_points, by_edges = spread(tracked.f[used], weight, tracked.points.feature[used], radius_m)
    seen = tracked.found
    # without the robust weights: what they leave out is what tells of a wrong pose
    length = tracked.points.weight[seen]
    residual = np.sqrt((length * tracked.residuals_px[seen] ** 2).sum() / length.sum())
    return FoundPose(
        tracked.X_RG, by_points, by_edges, tracked.sigma_px, tracked.found_share, float(residual)
    )
