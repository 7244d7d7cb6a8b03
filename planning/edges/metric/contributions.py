"""Contribution of each edge to each degree of freedom, in a view or along a trajectory.

Two numbers, from P = C^-1 with C the sum of the features' C_i:

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

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.planning.edges.metric.information import FeatureInformation, observable_covariance, variances
from polhode.records import Ints


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
