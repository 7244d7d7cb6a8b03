"""The thesis's inertia (eqs. 4.97-4.99): k1, k2 as free numbers, and the axes; also impossible bodies."""

from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.problem.inertia import inertia_from_second_moments, rotation_sx
from polhode.lie import Array, exp_so3, hat, right_jacobian_so3


class LogRatios:
    """``xi = (k1, k2, eta)``: J = R diag(exp k1, 1, exp -k2) R^T with R = R_ref Exp(eta)."""

    name = "log_ratios"

    def second_moments_sx(self, xi: Any, R_ref: Any) -> Any:
        """Not scaled to determinant 1, which an impossible body has none of."""
        R = R_ref @ rotation_sx(xi[2:5])
        moments = ca.vertcat(ca.exp(xi[0]), 1.0, ca.exp(-xi[1]))
        return R @ ca.diag(0.5 * ca.sum1(moments) - moments) @ R.T

    def second_moments(self, xi: Array, R_ref: Array) -> Array:
        """(3, 3), perhaps not positive."""
        R, moments = R_ref @ exp_so3(xi[2:5]), _moments(xi)
        return np.asarray(R @ np.diag(0.5 * moments.sum() - moments) @ R.T)

    def derivative(self, xi: Array, R_ref: Array) -> Array:
        """(5, 3, 3)"""
        R, moments = R_ref @ exp_so3(xi[2:5]), _moments(xi)
        d = 0.5 * moments.sum() - moments
        a, c = moments[0], moments[2]
        out = np.empty((5, 3, 3))
        out[0] = R @ np.diag([-0.5 * a, 0.5 * a, 0.5 * a]) @ R.T
        out[1] = R @ np.diag([-0.5 * c, -0.5 * c, 0.5 * c]) @ R.T
        turned = hat(right_jacobian_so3(xi[2:5]).T) @ np.diag(d)
        out[2:] = R @ (turned + np.swapaxes(turned, 1, 2)) @ R.T
        return out

    def coordinates(self, second: Array) -> tuple[Array, Array]:
        """Of a possible body."""
        moments, R = np.linalg.eigh(inertia_from_second_moments(second))
        moments, R = moments[::-1], R[:, ::-1]
        R = R * np.array([1.0, 1.0, np.linalg.det(R)])
        k1, k2 = np.log(moments[0] / moments[1]), np.log(moments[1] / moments[2])
        return np.array([k1, k2, 0.0, 0.0, 0.0]), R


def possible(xi: Array) -> bool:
    """Whether the moments obey the triangle inequality."""
    moments = _moments(xi)
    return bool(2.0 * moments.max() < moments.sum())


def _moments(xi: Array) -> Array:
    return np.array([np.exp(xi[0]), 1.0, np.exp(-xi[1])])
