"""Centres of mass inside the hull that the motion admits: linear programs.

The centre of mass of any mass that is nowhere negative lies in the convex hull of the body. Where the motion
determines all but a shift along the axis of rotation, what remains is the piece of that axis inside the hull.
"""

import numpy as np
from scipy.optimize import linprog

from polhode.lie import Array
from polhode.pipeline.intervals.body_hull import BodyHull
from polhode.pipeline.intervals.motion_limits import MotionLimits


def farthest_com(hull: BodyHull, limits: MotionLimits, direction_G: Array) -> Array | None:
    """The admitted centre of mass (3,) that is farthest along a direction (3,) of G; None: there is none."""
    axes = limits.com_axes
    offset = axes.T @ limits.center_G
    found = linprog(
        -direction_G,
        A_ub=np.concatenate([hull.normals, axes.T, -axes.T]),
        b_ub=np.concatenate([hull.offsets, offset + limits.com_margin_m, limits.com_margin_m - offset]),
        bounds=(None, None),
        method="highs",
    )
    return np.asarray(found.x) if found.status == 0 else None


def com_extremes(hull: BodyHull, limits: MotionLimits, directions_G: Array) -> Array | None:
    """Admitted centres of mass (n, 2, 3) [m] that are farthest back and forth along directions (n, 3)."""
    out = np.empty((len(directions_G), 2, 3))
    for n, direction in enumerate(directions_G):
        for side, sign in enumerate((-1.0, 1.0)):
            found = farthest_com(hull, limits, sign * direction)
            if found is None:
                return None
            out[n, side] = found
    return out
