"""Control points that stand clear of other edges: where two run side by side the image shows one, between.

That is also so at a face seen edge-on, whose other side may be hidden at one pose and in sight at the next.
"""

import numpy as np
from scipy.spatial import cKDTree

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose
from polhode.planning.edges.model.edge_model import EdgeModel
from polhode.planning.edges.model.seen_edges import ControlPoints, control_points
from polhode.records import Bools

SAME_PX = 0.5
"""Edges nearer than this across are one edge, cut in pieces."""
EDGE_ON = 0.05
"""Sine of the angle to a face's plane below which it is seen edge-on: half a metre looks 4 px wide at 4 m."""
APART_PX = 4.0


def clear_points(
    model: EdgeModel, rig: RectifiedRig, X_RG: Array, spacing_px: float, apart_px: float = APART_PX
) -> ControlPoints:
    """Control points of a view, less those that the image cannot tell from others."""
    points = control_points(model, rig, X_RG, spacing_px)
    points = points[~beside_face_edge_on(points, model, X_RG)]
    return points[stands_clear(points, apart_px)]


def beside_face_edge_on(points: ControlPoints, model: EdgeModel, X_RG: Array) -> Bools:
    """(m,) of the points on segments: whether a face beside it is seen edge-on."""
    ray = points.p_G - inverse_pose(X_RG)[:3, 3]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    sine = np.abs(np.einsum("msk,mk->ms", points.sides_G, ray)).min(axis=1)
    return np.asarray((points.feature < len(model.ends_G)) & (sine < EDGE_ON))


def stands_clear(points: ControlPoints, least_px: float) -> Bools:
    """(m,) false where one of another edge is nearer than ``least_px``, beside this one, not along it."""
    clear = np.ones(len(points), dtype=bool)
    if len(points) == 0:
        return clear
    pairs = cKDTree(points.uv_px).query_pairs(least_px, output_type="ndarray")
    pairs = pairs[points.feature[pairs[:, 0]] != points.feature[pairs[:, 1]]]
    apart = points.uv_px[pairs[:, 0]] - points.uv_px[pairs[:, 1]]
    for one in pairs.T:
        across = np.abs(np.einsum("mk,mk->m", apart, points.normal_px[one]))
        clear[one[across > SAME_PX]] = False
    return clear
