"""Poses as an edge tracker would find them, without images: its linear model, with the errors of edges.

Each control point is off by sigma of its own and by tau that its edge's points share. An edge is found where
sunlight makes a step of brightness across it; the rest tells nothing. Now and then the fit converges on a
wrong pose: a part of the edges agrees, to a pixel, on a step of several pixels, and the rest is found only
where it still lies within reach.
"""

from dataclasses import dataclass

import numpy as np

from planning.observability.edge_model import EdgeModel
from planning.observability.edge_motion import edge_motion, moved
from planning.observability.metric import observability
from planning.observability.pose_weights import TrackedPose
from planning.observability.seen_edges import ControlPoints, control_points
from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose
from polhode.records import Bools, Ints


@dataclass(frozen=True)
class EdgeErrors:
    """How edges are found."""

    sigma_px: float = 0.4
    """of each control point"""
    tau_px: float = 0.3
    """of each edge, shared by its points"""
    least_contrast: float = 0.08
    """step of brightness across an edge that is found; white in full sunlight has 1"""
    ambient: float = 0.03
    """brightness in the shade"""
    misfit_px: float = 1.0
    """of each edge on a wrong pose that it agrees with"""
    reach_px: float = 4.0
    """farther off nothing is found"""
    spacing_px: float = 10.0


def drawn_pose(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    sun_R: Array,
    wrong: bool,
    rng: np.random.Generator,
    errors: EdgeErrors,
) -> TrackedPose | None:
    """A pose that a tracker finds when the true one is X_RG (4, 4); None where it finds nothing.

    sun_R (3,): to the Sun, in the camera.
    """
    seen = control_points(model, rig, X_RG, errors.spacing_px)
    points = seen[contrast(seen, X_RG, sun_R, errors.ambient) > errors.least_contrast]
    if len(points) < 6:
        return None
    f = edge_motion(points, rig, X_RG, model.middle_G)
    edges, of_edge = np.unique(points.feature, return_inverse=True)
    offset = errors.sigma_px * rng.standard_normal(len(points))
    offset += errors.tau_px * rng.standard_normal(len(edges))[of_edge]
    found = np.ones(len(points), dtype=bool)
    if wrong:
        caught, away = _caught(f, points.weight, of_edge, model.radius_m, rng)
        misfit = errors.misfit_px * rng.standard_normal(len(edges))[of_edge]
        offset = offset + np.where(caught, away + misfit, 0.0)
        first = _fit(f[caught], points.weight[caught], offset[caught], model.radius_m)
        found = np.abs(offset - f @ first) < errors.reach_px
    f, weight, offset, of_edge = f[found], points.weight[found], offset[found], of_edge[found]
    step = _fit(f, weight, offset, model.radius_m)
    left = offset - f @ step
    freedom = 1.0 - 6.0 / max(len(f), 7)
    spread = np.sqrt((weight * left**2).sum() / weight.sum() / freedom)
    return TrackedPose(
        moved(X_RG, step, model.middle_G),
        information(f, weight, of_edge, model.radius_m, errors),
        float(weight.sum() / seen.weight.sum()),
        float(spread / np.hypot(errors.sigma_px, errors.tau_px)),
    )


def information(f: Array, weight: Array, of_edge: Ints, radius_m: float, errors: EdgeErrors) -> Array:
    """Inverse (6, 6) of the covariance of the fit's step where errors are shared along edges.

    C^-1 (sigma^2 sum w^2 f f^T + tau^2 sum over edges of g g^T) C^-1, g = sum of w f over an edge. What C
    does not tell has no information.
    """
    metric = observability(f, weight, radius_m)
    values, directions = metric.scaled
    seen = len(metric.unseen)
    V = directions[:, seen:] / metric.scale[:, None]
    # rows: the step along told directions per pixel of each point
    gain = (directions[:, seen:] * metric.scale[:, None]).T @ (f * weight[:, None]).T / values[seen:, None]
    shared = np.zeros((len(V.T), int(of_edge.max()) + 1))
    np.add.at(shared.T, of_edge, gain.T)
    spread = errors.sigma_px**2 * gain @ gain.T + errors.tau_px**2 * shared @ shared.T
    return np.asarray(V @ np.linalg.solve(spread, V.T))


def contrast(points: ControlPoints, X_RG: Array, sun_R: Array, ambient: float) -> Array:
    """Step of brightness (m,) across edges of a white body before a black sky; no shadows are cast."""
    eye_G, sun_G = inverse_pose(X_RG)[:3, 3], X_RG[:3, :3].T @ sun_R
    to_eye = eye_G - points.p_G
    bright = ambient + np.maximum(points.sides_G @ sun_G, 0.0)
    faces = np.einsum("msk,mk->ms", points.sides_G, to_eye) > 0.0
    bright = np.where(faces, bright, 0.0)
    outline = np.all(points.sides_G[:, 0] == points.sides_G[:, 1], axis=1)
    step = np.abs(bright[:, 0] - bright[:, 1])
    return np.where(outline, ambient + np.maximum(points.sides_G[:, 0] @ sun_G, 0.0), step)


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


def _fit(f: Array, weight: Array, offset: Array, radius_m: float) -> Array:
    """The step (6,) of least squares; nothing along directions that are not told."""
    metric = observability(f, weight, radius_m)
    values, directions = metric.scaled
    seen = len(metric.unseen)
    D = directions[:, seen:] * metric.scale[:, None]
    return np.asarray(D @ ((D.T @ (f.T @ (weight * offset))) / values[seen:]))
