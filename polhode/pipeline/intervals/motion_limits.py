"""What the motion determines of centre of mass and inertia, as linear inequalities.

The centre of mass of any mass that is nowhere negative lies in the convex hull of the body. Where the motion
determines all but a shift along the axis of rotation, what remains is the piece of that axis inside the hull,
whose ends linear programs find.

Linear in J, and not in the solver's parameters: Euler's equations are linear in J, so what a motion leaves
free is a cone of J. A steady spin about u, for example, demands that u is a principal axis, which is two
linear equations, however far the other moments are from the estimate.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from polhode.geometry.lie import Array
from polhode.pipeline.intervals.body_hull import BodyHull

SIGMAS = 5.0
"""A determined combination of components lies within that many of its standard deviations."""
LINEAR_BELOW = 0.06
"""A standard deviation of the solver's parameters, which are logarithms: above it, where the estimate may be
far from linear, the limit is twice as wide. It is the one from which on k1 and k2 count as undetermined."""
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the six components of a symmetric matrix."""


@dataclass(frozen=True)
class MotionLimits:
    """``|com_axes^T (com_G - center_G)| <= com_margin_m`` and ``inertia_rows @ J <= 0``, J any scale."""

    center_G: Array
    """(3,) the estimate [m]"""
    com_axes: Array
    """(3, 3) orthonormal columns"""
    com_margin_m: Array
    """(3,)"""
    inertia_rows: Array
    """(m, 6) of J by PAIRS"""
    R_GP: Array
    """(3, 3) the estimated axes"""


def motion_limits(
    com_G: Array, R_GP: Array, J_G: Array, J_jacobian: Array, covariance: Array, w_G: Array, reach_m: float
) -> MotionLimits:
    """The limits of an estimate.

    J_G (3, 3) in the scale of the solver's parameters, J_jacobian (5, 3, 3) its derivative by them.
    covariance (20, 20) of the last state: ``MotionEstimate.covariance_last_body``; w_G (3,) [rad/s].
    reach_m: how far from the estimate the centre of mass can be.
    """
    variance, axes = np.linalg.eigh(covariance[17:20, 17:20])
    sigma_m = np.sqrt(np.maximum(variance, 0.0))
    # A shift that is free is one along the axis of rotation, whose own direction has a standard deviation.
    rate = float(np.linalg.norm(w_G))
    tilt = float(np.sqrt(np.linalg.eigvalsh(covariance[9:12, 9:12])[-1])) / max(rate, 1e-12)
    margin = SIGMAS * (sigma_m + min(tilt, 1.0) * min(reach_m, SIGMAS * float(sigma_m.max())))
    return MotionLimits(com_G, axes, margin, _inertia_rows(J_G, J_jacobian, covariance[12:17, 12:17]), R_GP)


def _inertia_rows(J_G: Array, J_jacobian: Array, covariance: Array) -> Array:
    """(10, 6): J / s = J_G + sum of y_n dJ/dxi_n, the y bounded along the eigenvectors of their covariance.

    The scale s and s y are linear in J.
    """
    basis = np.stack([[each[pair] for pair in PAIRS] for each in (*J_jacobian, J_G)], axis=1)
    of_J = np.linalg.inv(basis)
    variance, vectors = np.linalg.eigh(covariance)
    change, scale = vectors.T @ of_J[:5], of_J[5]
    sigma = np.sqrt(np.maximum(variance, 0.0))
    bound = (SIGMAS * np.where(sigma < LINEAR_BELOW, 1.0, 2.0) * sigma)[:, None] * scale
    return np.concatenate([change - bound, -change - bound])


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
