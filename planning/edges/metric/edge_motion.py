"""Image motion of edges when the target moves: one column for each generator of SE(3).

Drummond and Cipolla, IEEE PAMI 24(7), 2002, in metres, radians and pixels: L_i is the image motion of a point
under generator i, f_i = L_i . n its component normal to the edge. Here the generators move the target: three
translations along the axes of R, then three rotations about axes parallel to them through a given point o.
"""

import numpy as np

from polhode.camera import RectifiedRig
from polhode.lie import Array, exp_so3, log_so3, transform_points
from polhode.planning.edges.model.visible_edges import ControlPoints

DEGREES_OF_FREEDOM = ("x", "y", "z", "about x", "about y", "about z")
"""Translations along R's axes (right, down, forward), rotations about them through o."""


def edge_motion(points: ControlPoints, rig: RectifiedRig, X_RG: Array, o_G: Array) -> Array:
    """f (m, 6): motion normal to the edges [px per m, px per rad] per motion of the target about o_G (3,)."""
    p_R = transform_points(X_RG, points.p_G)
    o_R = transform_points(X_RG, o_G[None])[0]
    x, y, z = p_R.T
    nx, ny = points.normal_px.T
    scale = rig.focal_px / z
    # n^T d(u, v)/dp
    shift = np.stack([scale * nx, scale * ny, -scale * (nx * x + ny * y) / z], axis=1)
    return np.hstack([shift, np.cross(p_R - o_R, shift)])


def moved(X_RG: Array, step: Array, o_G: Array) -> Array:
    """The pose (4, 4) after a step (6,) of the generators: rotated about o, then translated [m, rad]."""
    R_step = exp_so3(step[3:])
    o_R = X_RG[:3, :3] @ o_G + X_RG[:3, 3]
    X = np.eye(4)
    X[:3, :3] = R_step @ X_RG[:3, :3]
    X[:3, 3] = R_step @ (X_RG[:3, 3] - o_R) + o_R + step[:3]
    return X


def pose_error(X_RG: Array, true_X_RG: Array, o_G: Array) -> Array:
    """Step (6,) from the true pose to an estimate: translation of o along R's axes [m], rotation [rad]."""
    shift = (X_RG[:3, :3] - true_X_RG[:3, :3]) @ o_G + X_RG[:3, 3] - true_X_RG[:3, 3]
    return np.concatenate([shift, log_so3(X_RG[:3, :3] @ true_X_RG[:3, :3].T)])
