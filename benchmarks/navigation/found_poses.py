"""Poses of a flight, as records keep them: from the linear model of an edge tracker, or tracked in images.

Drawn: each control point is off by sigma of its own and by tau that its edge's points share. An edge is found
where sunlight makes a step of brightness across it; other edges give no information. Now and then the fit
converges to a wrong pose: a part of the edges agrees, to a pixel, on a step of several pixels, and the others
are found only where they still lie within reach.

Tracked: the tracker starts near the true pose, as from a filter that has converged, or far from it, as from
one that has not. All filters get the poses of the same start, so that they differ by the weights alone.
Shadows are black.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.edges.observability import LENS
from benchmarks.edges.tracking.calibrated_covariance import EdgeNoise, NoiseParts
from benchmarks.edges.tracking.residual import probability, support
from benchmarks.edges.tracking.tracker import TrackerOptions, TrackingResult, polarity, track
from benchmarks.edges.views import EdgeViews, ViewOptions, edge_body
from benchmarks.navigation.flights import SimulatedFlight, sun_R
from polhode.camera import RectifiedRig
from polhode.dataset_writer import write_png
from polhode.images import Grey, read_raw
from polhode.lie import Array, inverse_pose
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import (
    edge_motion,
    motion_scale,
    moved,
    observable_covariance,
)
from polhode.planning.edges.visible_edges import contrast, control_points
from polhode.records import Bools, Ints

OBSERVABLE = 1e-9
"""Variances below this share of the largest, translations in radii, belong to unobservable motions."""


@dataclass(frozen=True)
class TrackedPose:
    """What an edge tracker hands on for one image."""

    X_RG: Array
    """(4, 4) the pose found"""
    information: Array
    """(6, 6) inverse of the calibrated covariance; singular where edges do not tell"""
    found_share: float
    """control points found over expected: the binary metric's number"""
    residual: float
    """what is left across the edges, over what the error model lets expect"""


@dataclass(frozen=True)
class FoundPose:
    """A pose (4, 4) and how errors of edges spread into it."""

    X_RG: Array
    noise: NoiseParts
    """of this fit alone; without rows and columns where edges do not tell"""
    found_share: float
    doubts: dict[str, float]
    """statistics that are larger on wrong poses"""

    def tracked(self, levels: EdgeNoise, doubt: str, radius_m: float) -> TrackedPose:
        """With the covariance of these levels, and one of the statistics."""
        scale = motion_scale(radius_m)
        covariance = levels.covariance(self.noise)[0] / np.outer(scale, scale)
        values, directions = np.linalg.eigh(covariance)
        observable = values > OBSERVABLE * values[-1]
        D = directions[:, observable] / scale[:, None]
        return TrackedPose(self.X_RG, (D / values[observable]) @ D.T, self.found_share, self.doubts[doubt])

    def line(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "pose": self.X_RG[:3].ravel().tolist(),
            "parts": self.noise.parts.ravel().tolist(),
            "residual_px": float(self.noise.residual_px[0]),
            "found": self.found_share,
            "doubts": self.doubts,
        }


def from_line(line: dict[str, Any]) -> FoundPose:
    """From JSON."""
    X = np.vstack([np.reshape(line["pose"], (3, 4)), [0.0, 0.0, 0.0, 1.0]])
    noise = NoiseParts(np.reshape(line["parts"], (1, 3, 6, 6)), np.array([line["residual_px"]]))
    return FoundPose(X, noise, line["found"], line["doubts"])


def spread(f: Array, weight: Array, of_edge: Ints, sign: Ints, radius_m: float) -> tuple[Array, Array]:
    """From offsets (m,) to the step of the fit (6, m), and its covariances for unit noise (3, 6, 6).

    `calibrated_covariance.noise_parts` where all is observable. Unobservable motions get no step.
    """
    weighted = f * weight[:, None]
    gain = observable_covariance(weighted.T @ f, radius_m) @ weighted.T
    shared = np.zeros((6, int(of_edge.max(initial=-1)) + 1))
    np.add.at(shared.T, of_edge, gain.T)
    limb = gain @ sign
    return gain, np.stack([gain @ gain.T, shared @ shared.T, np.outer(limb, limb)])


@dataclass(frozen=True)
class EdgeErrors:
    """How edges are found."""

    sigma_px: float = 0.4
    """of each control point"""
    tau_px: float = 0.3
    """of each edge, shared by its points"""
    min_contrast: float = 0.05
    """step of radiance across an edge that is found; white across the sunlight has 1"""
    misfit_px: float = 1.0
    """of each edge on a wrong pose that it agrees with"""
    reach_px: float = 4.0
    """farther off nothing is found"""
    spacing_px: float = 10.0


def drawn_poses(
    course: SimulatedFlight, model: EdgeModel, rig: RectifiedRig, seed: int
) -> tuple[list[FoundPose | None], list[FoundPose | None]]:
    """At each instant of a flight the usual pose, and one after a wrong convergence."""
    usual: list[FoundPose | None] = []
    bad: list[FoundPose | None] = []
    for k in range(len(course.states)):
        for wrong, poses in (False, usual), (True, bad):
            rng = np.random.default_rng([seed, 0xD4A4, k])
            sun = sun_R(course.R_NR[k])
            poses.append(drawn_pose(model, rig, course.X_RG(k), sun, wrong, rng, EdgeErrors()))
    return usual, bad


def drawn_pose(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    sun_R: Array,
    wrong: bool,
    rng: np.random.Generator,
    errors: EdgeErrors,
) -> FoundPose | None:
    """A pose that a tracker finds when the true one is X_RG (4, 4); None where it finds nothing.

    sun_R (3,): to the Sun, in the camera.
    """
    seen = control_points(model, rig, X_RG, errors.spacing_px)
    eye_G, sun_G = inverse_pose(X_RG)[:3, 3], X_RG[:3, :3].T @ sun_R
    points = seen[contrast(model, seen, eye_G, sun_G) > errors.min_contrast]
    if len(points) < 6:
        return None
    f = edge_motion(points, rig, X_RG, model.centre_G)
    edges, of_edge = np.unique(points.feature, return_inverse=True)
    offset = errors.sigma_px * rng.standard_normal(len(points))
    offset += errors.tau_px * rng.standard_normal(len(edges))[of_edge]
    found = np.ones(len(points), dtype=bool)
    # exposure moves no limb here
    sky = np.zeros(len(points), dtype=np.int64)
    if wrong:
        caught, away = _caught(f, points.weight, of_edge, model.radius_m, rng)
        misfit = errors.misfit_px * rng.standard_normal(len(edges))[of_edge]
        offset = offset + np.where(caught, away + misfit, 0.0)
        gain, _ = spread(f[caught], points.weight[caught], of_edge[caught], sky[caught], model.radius_m)
        found = np.abs(offset - f @ (gain @ offset[caught])) < errors.reach_px
    f, weight, offset, of_edge = f[found], points.weight[found], offset[found], of_edge[found]
    gain, parts = spread(f, weight, of_edge, sky[found], model.radius_m)
    step = gain @ offset
    left = offset - f @ step
    freedom = 1.0 - 6.0 / max(len(f), 7)
    residual = float(np.sqrt((weight * left**2).sum() / weight.sum() / freedom))
    return FoundPose(
        moved(X_RG, step, model.centre_G),
        NoiseParts(parts[None], np.array([residual])),
        float(weight.sum() / seen.weight.sum()),
        {"residual": residual},
    )


def _caught(
    f: Array, weight: Array, of_edge: Ints, radius_m: float, rng: np.random.Generator
) -> tuple[Bools, Array]:
    """Which points (m,) agree on a wrong pose, and how far away it takes them [px]."""
    share, size_px = rng.uniform(0.5, 0.9), rng.uniform(3.0, 12.0)
    away = f @ (rng.standard_normal(6) * motion_scale(radius_m))
    away *= size_px / np.sqrt((weight * away**2).sum() / weight.sum())
    order = rng.permutation(of_edge.max() + 1)
    mass = np.bincount(of_edge, weight)[order]
    taken = np.cumsum(mass) - mass < share * weight.sum()
    return np.isin(of_edge, order[taken]), away


VIEWS = ViewOptions(earth=0.0, sensor=LENS)
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
