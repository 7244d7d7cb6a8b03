"""What errors of a measured mesh do to the pose that its edges give.

A tracker moves the edges of a model onto those of the image. Where the model's edges are wrong, weighted
least squares turn their displacements into an error of the pose, the same way in every image of that view:

    pose error = -C^-1 sum_i w_i f_i (f_i,G . d_i)        d_i: of the model's point from the true one, in G

Two kinds of displacements: those of the whole surface outward, a length that is the same everywhere, and
those of each segment by itself, by the covariance of its ends
(``polhode/planning/edges/edge_refinement.py``). Directions that a view does not determine have a large,
finite variance.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array
from polhode.planning.edges.edge_refinement import RefinedEdges
from polhode.planning.edges.observability_metric import edge_motion, motion_scale
from polhode.planning.edges.visible_edges import ControlPoints

MIN_OPENING = 0.5
"""Of 1 + cos between the faces' normals: sharper edges do not recede without bound."""
UNSEEN = 0.5
"""Sigma of a direction that a view does not determine: radii of the body, or radians"""


@dataclass(frozen=True)
class PoseErrors:
    """Of a pose of one view."""

    noise: Array
    """(6, 6) covariance by the image [m^2, m rad, rad^2]"""
    edges: Array
    """(6, 6) covariance by the displacements of single edges"""
    outward: Array
    """(6,) for a surface that is too large by one metre"""


def covariance_of(C: Array, radius_m: float) -> Array:
    """(6, 6) of the information C (6, 6), with ``UNSEEN`` besides."""
    return np.asarray(np.linalg.inv(C + np.diag((UNSEEN * motion_scale(radius_m)) ** -2.0)))


def pose_errors(
    edges: RefinedEdges,
    rig: RectifiedRig,
    X_RG: Array,
    points: ControlPoints,
    weight: Array,
    noise: Array | None = None,
) -> PoseErrors:
    """Of a pose that rests on points (m,) of segments with weights (m,) [px^-2].

    ``noise`` (6, 6) as in ``PoseErrors``; None: that of the weights.
    """
    model = edges.model
    f = edge_motion(points, rig, X_RG, model.centre_G)
    inverse = covariance_of((f * weight[:, None]).T @ f, model.radius_m)
    along_G = f[:, :3] @ X_RG[:3, :3]
    # where both faces beside an edge lie outside by one metre, the edge is off by more than that
    both = np.einsum("mk,mk->m", points.sides_G[:, 0], points.sides_G[:, 1])
    off_G = points.sides_G.sum(axis=1) / np.maximum(1.0 + both, MIN_OPENING)[:, None]
    lifted = f.T @ (weight * np.einsum("mk,mk->m", along_G, off_G))
    by_ends = np.einsum("mi,mij->mj", along_G, edges.at(points))
    pull = np.zeros((len(edges.covariance), 6, 6))
    np.add.at(pull, points.feature, weight[:, None, None] * f[:, :, None] * by_ends[:, None, :])
    scatter = np.einsum("nik,nkl,njl->ij", pull, edges.covariance, pull)
    return PoseErrors(
        inverse if noise is None else noise, np.asarray(inverse @ scatter @ inverse), -inverse @ lifted
    )
