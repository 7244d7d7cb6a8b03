"""Information about the pose along a trajectory, per view and per edge, and the contribution of each edge.

``views_along`` yields the metric of each view; ``by_feature`` has one matrix for each feature of a view, from
which contributions and selections of edges are computed. ``contributions`` gives two numbers for
each edge, from P = C^-1 with C the sum of the features' C_i:

share: (P C_i P)_dd / P_dd. Least squares weights the measured distances by P f; the noise that enters
    through feature i is P C_i P, and over all features these add up to P. So the shares of a degree of
    freedom add up to 1, also when an edge is cut into pieces. The share is what the figures show: on which
    edges the estimate of this degree of freedom rests.
rise: (C - C_i)^-1_dd / P_dd - 1, the relative increase of the variance without the feature; inf where no
    other feature determines it. It is the criterion for removing one edge. For a small C_i it equals the
    share: P C_i P is the first-order term of the rise. Two redundant edges each have a small rise, though one
    of them is required: rises do not add up, and sets of edges are chosen in `selection.py`.

An edge's own (C_i)_dd / C_dd, the information if all other degrees of freedom were known, is neither: an
edge that determines only a combination of x and a rotation has much of both and may determine neither.

Along a trajectory the variances are means over its views, except views in which the degree of freedom is
unobservable.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, inverse_pose
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    is_unobservable,
    motion_scale,
    observability,
    observable_covariance,
    spectrum,
)
from polhode.planning.edges.visible_edges import (
    SPACING_PX,
    ControlPoints,
    control_points,
    in_sunlight,
    why_no_edge,
)


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
        return np.asarray(self.C * np.outer(motion_scale(self.radius_m), motion_scale(self.radius_m)))


def by_feature(points: ControlPoints, f: Array, size: int) -> Array:
    """Sums of w f f^T (size, 6, 6) over the points of each feature."""
    C = np.zeros((size, 6, 6))
    np.add.at(C, points.feature, points.weight[:, None, None] * f[:, :, None] * f[:, None, :])
    return C


def variances(C: Array, radius_m: float) -> Array:
    """Diagonals (..., 6) of C^-1 [m^2, rad^2 for one pixel], inf where C (..., 6, 6) does not determine them.

    As `EdgeObservability.covariance`, for many matrices at once.
    """
    values, directions, observable = spectrum(C, radius_m)
    inverse_values = np.where(observable, 1.0 / np.where(observable, values, 1.0), 0.0)
    variance = np.einsum("...ij,...j->...i", directions**2, inverse_values) * motion_scale(radius_m) ** 2
    return np.where(is_unobservable(directions, observable), np.inf, variance)


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
    reason: str = ""
    """why no edge is visible; empty where one is"""

    def describe_unobservable(self) -> str:
        """Description of the unobservable directions; empty where the whole pose is observable."""
        if self.reason:
            return f"no edge is visible ({self.reason}): the whole pose is unobservable"
        return self.metric.describe_unobservable()

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
        reason = "" if len(points) else why_no_edge(model, rig, X)
        if sun_G is not None and len(points):
            points = in_sunlight(model, points, inverse_pose(X)[:3, 3], sun_G[k])
            reason = "" if len(points) else "none has contrast in this sunlight"
        f = edge_motion(points, rig, X, o_G)
        metric = observability(f, points.weight, model.radius_m)
        yield EdgeView(X, points, f, metric, spacing_px * float(points.weight.sum()), o_G, reason)


@dataclass(frozen=True)
class Contributions:
    """Contributions of n features to the six degrees of freedom (`edge_motion.DEGREES_OF_FREEDOM`)."""

    share: Array
    """(n, 6) of the mean variance; columns add up to 1, or are NaN where no view determines it"""
    rise: Array
    """(n, 6) relative increase of the mean variance without the feature"""
    sigma: Array
    """(6,) root of the mean variance with all features [m/px, rad/px]; inf where no view determines it"""
    views: Ints
    """(6,) number of views that determine the degree of freedom"""


def contributions(information: FeatureInformation) -> Contributions:
    """Shares and rises over the views of the information; one view is a trajectory of length one."""
    C, total = information.C, information.total
    before = variances(total, information.radius_m)
    observable = np.isfinite(before)
    count = observable.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(observable, before, 0.0).sum(axis=0) / count
        part = np.zeros((C.shape[1], 6))
        for k, P in enumerate(observable_covariance(total, information.radius_m)):
            of_view = np.einsum("di,nij,dj->nd", P, C[k], P, optimize=True)
            part += np.where(observable[k], of_view, 0.0)
        share = part / count / mean
        without = np.zeros_like(part)
        for k in range(len(C)):
            remaining = variances(total[k] - C[k], information.radius_m)
            without += np.where(observable[k], remaining, 0.0)
        rise = without / count / mean - 1.0
    sigma = np.where(count > 0, np.sqrt(mean), np.inf)
    return Contributions(share, rise, np.asarray(sigma), np.asarray(count, dtype=np.int64))
