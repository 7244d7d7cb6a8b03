"""Poses that the edge tracker finds in rendered images of a flight.

The tracker starts near the true pose, as from a filter that is well, or far from it, as from one that is not.
The same start serves all filters: their differences are then those of the weights alone. Shadows are black.
"""

from pathlib import Path

import numpy as np

from benchmarks.edges.observability import LENS
from benchmarks.edges.tracking.calibrated_covariance import NoiseParts
from benchmarks.edges.tracking.residual import probability, support
from benchmarks.edges.tracking.tracker import TrackerOptions, TrackingResult, polarity, track
from benchmarks.edges.views import EdgeViews, ViewOptions, edge_body
from benchmarks.navigation.flights import SimulatedFlight, sun_R
from benchmarks.navigation.found_pose import FoundPose, spread
from polhode.camera import RectifiedRig
from polhode.dataset_writer import write_png
from polhode.images import Grey, read_raw
from polhode.lie import Array
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import moved

VIEWS = ViewOptions(earth=0.0, scattered=True, sensor=LENS)
TRACKING = TrackerOptions(restarts=0)
"""One start, as fast as a filter at each image needs it; it goes wrong more often than with restarts."""
NEAR = np.repeat([0.01, np.deg2rad(1.0)], 3)
"""Sigma of a usual start [m, rad]."""
FAR = np.repeat([0.06, np.deg2rad(6.0)], 3)
"""Of a bad one."""


def tracked_poses(
    course: SimulatedFlight, body: str, model: EdgeModel, rig: RectifiedRig, seed: int, folder: Path
) -> tuple[list[FoundPose | None], list[FoundPose | None]]:
    """At each instant the pose from a usual start, and from a bad one; None where the tracker gives none.

    Images are kept in ``folder``.
    """
    views = EdgeViews(edge_body(body, plain=True), rig, seed, VIEWS)
    rng = np.random.default_rng([seed, 0x7AC4])
    usual: list[FoundPose | None] = []
    bad: list[FoundPose | None] = []
    for k in range(len(course.states)):
        X_RG = course.X_RG(k)
        image = _image(views, X_RG, sun_R(course.R_NR[k]), k, folder).astype(np.float64)
        for sigma, poses in (NEAR, usual), (FAR, bad):
            start = moved(X_RG, sigma * rng.standard_normal(6), model.centre_G)
            tracked = track(model, rig, image, start, TRACKING)
            poses.append(_found(tracked, image, model.radius_m))
    return usual, bad


def _image(views: EdgeViews, X_RG: Array, sun: Array, k: int, folder: Path) -> Grey:
    path = folder / f"{k:03}.png"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_png(path, views.image(X_RG, sun, k))
    return np.asarray(read_raw(path, views.rig.width_px, views.rig.height_px), dtype=np.uint8)


def _found(tracked: TrackingResult, image: Array, radius_m: float) -> FoundPose | None:
    """What records keep of it."""
    used = tracked.robust > 0.0
    if not tracked.converged or used.sum() < 7:
        return None
    weight = (tracked.robust * tracked.points.weight)[used]
    _, of_edge = np.unique(tracked.points.feature[used], return_inverse=True)
    sky = polarity(tracked.beside)[used]
    _, parts = spread(tracked.f[used], weight, of_edge, sky, radius_m)
    seen = tracked.found
    # without the robust weights: what they leave out may tell of a wrong pose
    length = tracked.points.weight[seen]
    left_px = float(np.sqrt((length * tracked.residuals_px[seen] ** 2).sum() / length.sum()))
    by_image = support(tracked, image)
    doubts = {
        "residual": left_px,
        "robust residual": tracked.sigma_px,
        "unsupported": 1.0 - by_image.supported,
        "unsupported beyond chance": 1.0 - by_image.beyond_chance,
        "edges not whole": 1.0 - by_image.whole,
        "limbs": 1.0 - by_image.limb,
        "found but unsupported": by_image.found - by_image.supported,
        "improbable": 1.0 - float(probability(by_image.as_features[None])[0]),
    }
    noise = NoiseParts(parts[None], np.array([tracked.sigma_px]))
    return FoundPose(tracked.X_RG, noise, tracked.found_share, doubts)
