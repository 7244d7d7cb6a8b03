"""Poses as an edge tracker would find them, without images: its linear model, with the errors of edges.

Each control point is off by sigma of its own and by tau that its edge's points share. An edge is found where
sunlight makes a step of brightness across it; the rest tells nothing. Now and then the fit converges on a
wrong pose: a part of the edges agrees, to a pixel, on a step of several pixels, and the rest is found only
where it still lies within reach.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.edges.tracking.calibrated_covariance import NoiseParts
from benchmarks.navigation.flights import SimulatedFlight, sun_R
from benchmarks.navigation.found_pose import FoundPose, spread
from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import edge_motion, moved
from polhode.planning.edges.visible_edges import contrast, control_points
from polhode.records import Bools, Ints


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
    away = f @ (rng.standard_normal(6) * np.array([radius_m] * 3 + [1.0] * 3))
    away *= size_px / np.sqrt((weight * away**2).sum() / weight.sum())
    order = rng.permutation(of_edge.max() + 1)
    mass = np.bincount(of_edge, weight)[order]
    taken = np.cumsum(mass) - mass < share * weight.sum()
    return np.isin(of_edge, order[taken]), away
