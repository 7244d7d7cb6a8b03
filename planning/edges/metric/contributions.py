"""What each edge contributes to each degree of freedom, in a view or along a trajectory.

Two numbers, of P = C^-1 with C the sum of the features' C_i:

share: (P C_i P)_dd / P_dd. Least squares weighs the measured distances by P f; the noise that comes in
    through feature i is P C_i P, and over all features these add up to P. So the shares of a degree of
    freedom add up to 1, also those of the pieces into which an edge is cut. It is what is painted: on which
    edges the estimate of this degree of freedom rests.
rise: (C - C_i)^-1_dd / P_dd - 1, how much its variance rises without the feature; inf where nothing else
    tells it. It is what to look at before one edge is dropped. For a small C_i it is the share: P C_i P is
    the first term of the rise. Of two edges that tell the same each has a small rise, though one is needed:
    rises do not add up, and sets of edges are for `selection.py`.

Each edge's own (C_i)_dd / C_dd, information as if all other degrees of freedom were known, is neither: an
edge that tells x and a turn together, as one, has much of both and may tell neither.

Along a trajectory the variances are means over its views, those views apart where a degree of freedom is not
told at all.
"""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.planning.edges.metric.information import FeatureInformation, observable_covariance, variances
from polhode.records import Ints


@dataclass(frozen=True)
class Contributions:
    """Of n features to the six degrees of freedom (`edge_motion.DEGREES_OF_FREEDOM`)."""

    share: Array
    """(n, 6) of the mean variance; columns add up to 1, or are NaN where no view tells the degree"""
    rise: Array
    """(n, 6) of the mean variance without the feature"""
    sigma: Array
    """(6,) root of the mean variance with all features [m/px, rad/px]; inf where no view tells it"""
    views: Ints
    """(6,) number of views that tell the degree of freedom"""


def contributions(information: FeatureInformation) -> Contributions:
    """Shares and rises over the views of the information; one view is a trajectory of one."""
    C, total = information.C, information.total
    before = variances(total, information.radius_m)
    told = np.isfinite(before)
    count = told.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(told, before, 0.0).sum(axis=0) / count
        part = np.zeros((C.shape[1], 6))
        for k, P in enumerate(observable_covariance(total, information.radius_m)):
            of_view = np.einsum("di,nij,dj->nd", P, C[k], P, optimize=True)
            part += np.where(told[k], of_view, 0.0)
        share = part / count / mean
        without = np.zeros_like(part)
        for k in range(len(C)):
            left = variances(total[k] - C[k], information.radius_m)
            without += np.where(told[k], left, 0.0)
        rise = without / count / mean - 1.0
    sigma = np.where(count > 0, np.sqrt(mean), np.inf)
    return Contributions(share, rise, np.asarray(sigma), np.asarray(count, dtype=np.int64))
