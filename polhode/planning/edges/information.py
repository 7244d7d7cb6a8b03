"""Information about the pose along a trajectory, per view and per edge; contribution and selection of edges.

``contributions`` gives two numbers for each edge, from P = C^-1 with C the sum of the features' C_i:

share: (P C_i P)_dd / P_dd. Least squares weights the measured distances by P f; the noise that enters
    through feature i is P C_i P, and over all features these add up to P. So the shares of a degree of
    freedom add up to 1, also when an edge is cut into pieces.
rise: (C - C_i)^-1_dd / P_dd - 1, the relative increase of the variance without the feature; inf where no
    other feature determines it. For a small C_i it equals the share. Two redundant edges each have a small
    rise, though one of them is required: rises do not add up, and sets of edges are chosen by ``greedy``.

Along a trajectory the variances are means over its views, except views in which the degree of freedom is
unobservable.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints
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
    range_m: float
    """from the camera to o, the reference point of rotations and translations"""
    reason: str = ""
    """why no edge is visible; empty where one is"""

    def describe_unobservable(self) -> str:
        """Description of the unobservable directions; empty where the whole pose is observable."""
        if self.reason:
            return f"no edge is visible ({self.reason}): the whole pose is unobservable"
        return self.metric.describe_unobservable()

    @property
    def expected_edges(self) -> int:
        """Number of visible features: the edges expected by the binary metric, found over expected."""
        return len(np.unique(self.points.feature))


def views_along(model: EdgeModel, rig: RectifiedRig, X_RG: Array, o_G: Array) -> Iterator[EdgeView]:
    """Yield the views of a trajectory X_RG (k, 4, 4), about o_G (3,)."""
    for X in X_RG:
        points = control_points(model, rig, X)
        reason = "" if len(points) else why_no_edge(model, rig, X)
        f = edge_motion(points, rig, X, o_G)
        metric = observability(f, points.weight, model.radius_m)
        range_m = float(np.linalg.norm(X[:3, :3] @ o_G + X[:3, 3]))
        yield EdgeView(X, points, f, metric, SPACING_PX * float(points.weight.sum()), range_m, reason)


@dataclass(frozen=True)
class Contributions:
    """Contributions of n features to the six ``DEGREES_OF_FREEDOM``."""

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
        part, without = np.zeros((2, C.shape[1], 6))
        for k, P in enumerate(observable_covariance(total, information.radius_m)):
            of_view = np.einsum("di,nij,dj->nd", P, C[k], P, optimize=True)
            part += np.where(observable[k], of_view, 0.0)
            remaining = variances(total[k] - C[k], information.radius_m)
            without += np.where(observable[k], remaining, 0.0)
        share, rise = part / count / mean, without / count / mean - 1.0
    sigma = np.where(count > 0, np.sqrt(mean), np.inf)
    return Contributions(share, rise, np.asarray(sigma), np.asarray(count, dtype=np.int64))


def greedy(information: FeatureInformation, count: int) -> Ints:
    """At most ``count`` features, in the order in which they are chosen: the largest gain first.

    The gain of a set S is the fall of tr M^-1, M = I + the sum of its C_i with lengths in radii, in the mean
    over the views (A-optimality). The identity, a prior of one radius and one radian, gives the empty set a
    finite value. Fewer where the others have no information. Ties go to the lower index.
    """
    scale = motion_scale(information.radius_m)
    scaled = information.C * np.outer(scale, scale)
    free = np.flatnonzero((scaled.trace(axis1=2, axis2=3) > 0.0).any(axis=0))
    M, chosen = np.tile(np.eye(6), (len(scaled), 1, 1)), list[int]()
    while len(chosen) < count and len(free):
        inverse = np.linalg.inv(M + np.swapaxes(scaled[:, free], 0, 1))
        best = int(np.argmin(np.trace(inverse, axis1=-2, axis2=-1).mean(axis=-1)))
        chosen.append(int(free[best]))
        free = np.delete(free, best)
        M = M + scaled[:, chosen[-1]]
    return np.array(chosen, dtype=np.int64)


def sigma_ratio(information: FeatureInformation, features: Ints) -> Array:
    """(6,) sigma with some features over that with all, each the root of the mean variance over the views.

    inf where they do not determine it, NaN where not even all features do.
    """
    whole = variances(information.total, information.radius_m)
    part = variances(information.C[:, features].sum(axis=1), information.radius_m)
    mean_part, mean_whole = (np.where(np.isfinite(whole), each, 0.0).sum(axis=0) for each in (part, whole))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(mean_part / mean_whole))
