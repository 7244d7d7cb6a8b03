"""Information about the pose: per view along a trajectory, and per edge of the model.

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
    """Information of n features in T views, for one pixel of noise normal to the edges, about the point o."""

    C: Array
    """(T, n, 6, 6) [px^2 per m^2, m rad, rad^2] along R's axes of each view, or along G's"""
    radius_m: float
    """scale at which translations and rotations are compared"""

    @property
    def total(self) -> Array:
        """(T, 6, 6) of all features."""
        return np.asarray(self.C.sum(axis=1))

    @property
    def scaled(self) -> Array:
        """(T, n, 6, 6) with translations in radii, rotations in radians."""
        return np.asarray(self.C * np.outer(_scale(self.radius_m), _scale(self.radius_m)))

    def accumulated(self, R_RG: Array) -> "FeatureInformation":
        """Sum over the views R_RG (T, 3, 3): (1, n, 6, 6) along G's axes, for a known motion of the target.

        A tracker that does not know the motion estimates each pose on its own, and the views stay separate.
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
    """Views at X_RG (T, 4, 4), hidden lines removed; with sun_G (T, 3) edges are weighted by their contrast.

    About o_G (3,), by default the model's centre. ``clear``: without points that a tracker confuses with
    adjacent edges (`visible_edges.clear_points`), as a selection of edges requires.
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
    """Diagonals (..., 6) of C^-1 [m^2, rad^2 for one pixel], inf where C (..., 6, 6) does not determine them.

    As `EdgeObservability.covariance`, for many matrices at once.
    """
    values, directions, observable = _spectrum(C, radius_m)
    square = directions**2
    inverse_values = np.where(observable, 1.0 / np.where(observable, values, 1.0), 0.0)
    variance = np.einsum("...ij,...j->...i", square, inverse_values) * _scale(radius_m) ** 2
    unobservable = np.einsum("...ij,...j->...i", square, (~observable).astype(np.float64)) > 1e-6
    return np.where(unobservable, np.inf, variance)


def observable_covariance(C: Array, radius_m: float) -> Array:
    """(..., 6, 6) pseudoinverses of C (..., 6, 6) over its observable directions."""
    values, directions, observable = _spectrum(C, radius_m)
    inverse_values = np.where(observable, 1.0 / np.where(observable, values, 1.0), 0.0)
    inverse = (directions * inverse_values[..., None, :]) @ np.swapaxes(directions, -1, -2)
    return np.asarray(inverse * np.outer(_scale(radius_m), _scale(radius_m)))


def _scale(radius_m: float) -> Array:
    """(6,) radius for translations [m], 1 for rotations [rad]."""
    return np.array([radius_m] * 3 + [1.0] * 3)


def _spectrum(C: Array, radius_m: float) -> tuple[Array, Array, Bools]:
    """Eigenvalues (..., 6) with translations in radii, directions (..., 6, 6), and which are observable."""
    values, directions = np.linalg.eigh(C * np.outer(_scale(radius_m), _scale(radius_m)))
    observable = values > np.maximum(UNOBSERVABLE_INFORMATION * values[..., -1:], 1.0 / UNOBSERVABLE_SIGMA**2)
    return values, directions, np.asarray(observable)


@dataclass(frozen=True)
class EdgeView:
    """The edges visible from one pose, and the information that they give about it."""

    X_RG: Array
    """(4, 4) pose of the target in the camera frame"""
    points: ControlPoints
    f: Array
    """(m, 6) motion normal to the edges [px per m, px per rad]"""
    metric: EdgeObservability
    length_px: float
    """of all visible edges in the image"""
    o_G: Array
    """(3,) reference point of rotations and translations [m]"""

    @property
    def range_m(self) -> float:
        """From the camera to o."""
        return float(np.linalg.norm(self.X_RG[:3, :3] @ self.o_G + self.X_RG[:3, 3]))

    @property
    def expected_edges(self) -> int:
        """Number of visible features: the edges expected by the binary metric, found over expected."""
        return len(np.unique(self.points.feature))


def views_along(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    o_G: Array,
    spacing_px: float = SPACING_PX,
    sun_G: Array | None = None,
) -> Iterator[EdgeView]:
    """Yield the views of a trajectory X_RG (k, 4, 4), about o_G (3,).

    With sun_G (k, 3), towards the Sun, edges are weighted by their contrast.
    """
    for k, X in enumerate(X_RG):
        points = control_points(model, rig, X, spacing_px)
        if sun_G is not None:
            points = in_sunlight(model, points, inverse_pose(X)[:3, 3], sun_G[k])
        f = edge_motion(points, rig, X, o_G)
        metric = observability(f, points.weight, model.radius_m)
        yield EdgeView(X, points, f, metric, spacing_px * float(points.weight.sum()), o_G)
