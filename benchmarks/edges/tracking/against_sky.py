"""Which side of a control point is the body and which is sky: there the direction of the edge is known."""

import numpy as np

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose, transform_points
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.visible_edges import ControlPoints
from polhode.records import Bools, Ints

BESIDE_PX = 3.0
"""How far from the edge either side is looked at."""


def body_beside(points: ControlPoints, model: EdgeModel, rig: RectifiedRig, X_RG: Array) -> Bools:
    """(m, 2) whether a ray BESIDE_PX behind and before each point along its normal meets the body."""
    p_R = transform_points(X_RG, points.p_G)
    X_GR = inverse_pose(X_RG)
    out = np.zeros((len(points), 2), dtype=bool)
    for column, side in enumerate((-BESIDE_PX, BESIDE_PX)):
        beside = p_R.copy()
        beside[:, :2] += side * points.normal_px * (p_R[:, 2:] / rig.focal_px)
        # The occluder looks 2.5 radii back from a place: first before the point, then behind it.
        reach = 1.0 + 2.4 * model.radius_m / np.maximum(np.linalg.norm(beside, axis=1), 1e-9)
        for factor in np.ones_like(reach), reach:
            place_G = transform_points(X_GR, beside * factor[:, None])
            out[:, column] |= model.occluder.hides(X_GR[:3, 3], place_G, 0.0)
    return out


def polarity(beside: Bools) -> Ints:
    """(m,) 1 where the light grows along the normal, from a dark sky to the body; -1 the reverse; else 0."""
    return beside[:, 1].astype(np.int64) - beside[:, 0].astype(np.int64)
