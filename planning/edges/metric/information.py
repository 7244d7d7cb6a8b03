"""Information of edges about the pose: per view along a trajectory, and per edge of the model.

``views_along`` yields the metric of each view; ``feature_information`` keeps one matrix for each feature and
view, from which contributions and selections of edges are computed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose
from polhode.planning.edges.metric.edge_motion import edge_motion
from polhode.planning.edges.metric.observability_metric import (
    UNOBSERVABLE_INFORMATION,
    UNOBSERVABLE_SIGMA,
    EdgeObservability,
    observability,
)
from polhode.planning.edges.model.edge_contrast import in_sunlight
from polhode.planning.edges.model.edge_model import EdgeModel
from polhode.planning.edges.model.visible_edges import SPACING_PX, ControlPoints, clear_points, control_points
from polhode.records import Bools


@dataclass(frozen=True)
class FeatureInformation:
    """Information of n features in T views, for noise of one pixel across the edges, about the point o."""

    C: Array
    """(T, n, 6, 6) [px^2 per m^2, m rad, rad^2] along R's axes of each view, or along G's"""
    radius_m: float
    """with it shifts and turns are compared"""

    @property
    def total(self) -> Array:
        """(T, 6, 6) of all features."""
        return np.asarray(self.C.sum(axis=1))

    @property
    def scaled(self) -> Array:
        """(T, n, 6, 6) with shifts in radii, turns in radians."""
        return np.asarray(self.C * np.outer(_scale(self.radius_m), _scale(self.radius_m)))

    def accumulated(self, R_RG: Array) -> "FeatureInformation":
        """All views (T, 3, 3) as one, (1, n, 6, 6) along G's axes: for a motion of the target that is known.

        Without it a tracker estimates each pose on its own, and the views stay apart.
        """
        turn = np.zeros((len(R_RG), 6, 6))
        turn[:, :3, :3] = turn[:, 3:, 3:] = R_RG
        along_G = np.einsum("tji,tnjk,tkl->nil", turn, self.C, turn, optimize=True)
        return FeatureInformation(along_G[None], self.radius_m)


def feature_information(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    sun_G: Array | None = None,
    o_G: Array | None = None,
    spacing_px: float = SPACING_PX,
    clear: bool = False,
) -> FeatureInformation:
    """Views at X_RG (T, 4, 4), hidden lines removed; with sun_G (T, 3) edges count by their contrast.

    About o_G (3,), without it about the model's middle. ``clear``: without what a tracker cannot tell from
    edges beside it (`visible_edges.clear_points`), as is right for choosing.
    """
    about = model.middle_G if o_G is None else o_G
    C = np.zeros((len(X_RG), model.size, 6, 6))
    for k, X in enumerate(X_RG):
        points = (clear_points if clear else control_points)(model, rig, X, spacing_px)
        if sun_G is not None:
            points = in_sunlight(model, points, inverse_pose(X)[:3, 3], sun_G[k])
        C[k] = by_feature(points, edge_motion(points, rig, X, about), model.size)
    return FeatureInformation(C, model.radius_m)


def by_feature(points: ControlPoints, f: Array, size: int) -> Array:
    """Sums of w f f^T (size, 6, 6) over the points of each feature."""
    C = np.zeros((size, 6, 6))
    np.add.at(C, points.feature, points.weight[:, None, None] * f[:, :, None] * f[:, None, :])
    return C


def variances(C: Array, radius_m: float) -> Array:
    """Diagonals (..., 6) of C^-1 [m^2, rad^2 for one pixel], inf where C (..., 6, 6) does not tell.

    As `metric.Observability.covariance`, for many at once.
    """
    values, directions, seen = _spectrum(C, radius_m)
    square = directions**2
    told = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    variance = np.einsum("...ij,...j->...i", square, told) * _scale(radius_m) ** 2
    lost = np.einsum("...ij,...j->...i", square, (~seen).astype(np.float64)) > 1e-6
    return np.where(lost, np.inf, variance)


def observable_covariance(C: Array, radius_m: float) -> Array:
    """(..., 6, 6) inverses of C (..., 6, 6) over the motions that it tells."""
    values, directions, seen = _spectrum(C, radius_m)
    told = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    inverse = (directions * told[..., None, :]) @ np.swapaxes(directions, -1, -2)
    return np.asarray(inverse * np.outer(_scale(radius_m), _scale(radius_m)))


def _scale(radius_m: float) -> Array:
    """(6,) radius for shifts [m], 1 for turns [rad]."""
    return np.array([radius_m] * 3 + [1.0] * 3)


def _spectrum(C: Array, radius_m: float) -> tuple[Array, Array, Bools]:
    """Eigenvalues (..., 6) with shifts in radii, directions (..., 6, 6), and which count as seen."""
    values, directions = np.linalg.eigh(C * np.outer(_scale(radius_m), _scale(radius_m)))
    seen = values > np.maximum(UNOBSERVABLE_INFORMATION * values[..., -1:], 1.0 / UNOBSERVABLE_SIGMA**2)
    return values, directions, np.asarray(seen)


@dataclass(frozen=True)
class EdgeView:
    """What the camera sees of the edges from one place, and what that tells of the pose."""

    X_RG: Array
    """(4, 4) the target in the camera"""
    points: ControlPoints
    f: Array
    """(m, 6) motion across the edges [px per m, px per rad]"""
    found: EdgeObservability
    length_px: float
    """of all visible edges in the image"""
    o_G: Array
    """(3,) the point that turns are about and whose shifts are told [m]"""

    @property
    def range_m(self) -> float:
        """From the camera to o."""
        return float(np.linalg.norm(self.X_RG[:3, :3] @ self.o_G + self.X_RG[:3, 3]))

    @property
    def expected_edges(self) -> int:
        """Features in sight: what the binary metric, edges found against expected, expects."""
        return len(np.unique(self.points.feature))


def views_along(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    o_G: Array,
    spacing_px: float = SPACING_PX,
    sun_G: Array | None = None,
) -> Iterator[EdgeView]:
    """The views from a trajectory X_RG (k, 4, 4), about o_G (3,), one by one.

    With sun_G (k, 3), towards the Sun, edges count by their contrast.
    """
    for k, X in enumerate(X_RG):
        points = control_points(model, rig, X, spacing_px)
        if sun_G is not None:
            points = in_sunlight(model, points, inverse_pose(X)[:3, 3], sun_G[k])
        f = edge_motion(points, rig, X, o_G)
        found = observability(f, points.weight, model.radius_m)
        yield EdgeView(X, points, f, found, spacing_px * float(points.weight.sum()), o_G)
