"""Covariance of everything reported, from the Gauss-Newton information at the solution.

The information is singular: G and its landmarks may move together. G is held at its pose in the first frame.
What does not depend on that choice (r_N, v_N, the attitude of the principal axes, w_P) gets its absolute
covariance: the camera's frame is known; with G held, the landmarks carry the uncertainty of the first pose.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from backend.gauss_newton import GaussNewton
from backend.inertia import InertiaForm, inertia_from_second_moments, principal_axes
from backend.iterate import Iterate
from backend.kernels import N_CONSTANTS, N_STATE
from backend.problem import Held
from backend.schur import landmark_covariances
from polhode.lie import Array, hat

N_GAUGE = 6
SMALLEST_GAP = 1e-6
"""Least difference of two moments (middle one 1) in the derivative of the axes."""


@dataclass(frozen=True)
class Marginals:
    """Joint covariance of states and constants, those of the landmarks, information of the constants."""

    dense: Array
    """(12 F + 8, 12 F + 8); zero for the first pose"""
    landmarks: Array
    """(L, 3, 3) [m^2]"""
    constants_information: Array
    """(8, 8) of com_G and xi, everything else eliminated, without prior"""
    response: Array
    """(12 F, 8) how the states follow when the constants are changed and everything else is fitted again"""


def marginals(solver: GaussNewton, held: Held, x: Array, weight: Array) -> Marginals:
    """Invert the information at x; weight (M,) is the information that each observation contributes."""
    bare = solver.normal_equations(held, x, weight, prior=False)
    S, _, C_inv = solver.reduced(bare)
    n, first = len(S), N_GAUGE
    n_states = n - N_CONSTANTS
    S = np.tril(S) + np.tril(S, -1).T
    factor = cho_factor(S[first:n_states, first:n_states], lower=True, check_finite=False)
    response = np.zeros((n_states, N_CONSTANTS))
    response[first:] = -cho_solve(factor, S[first:n_states, n_states:], check_finite=False)
    information = S[n_states:, n_states:] + S[n_states:, :n_states] @ response
    information = 0.5 * (information + information.T)
    constants = np.linalg.inv(information + solver.prior_information(held, x))
    dense = np.zeros((n, n))
    inner = cho_solve(factor, np.eye(n_states - first), check_finite=False)
    dense[first:n_states, first:n_states] = inner + response[first:] @ constants @ response[first:].T
    dense[:n_states, n_states:] = response @ constants
    dense[n_states:, :n_states] = dense[:n_states, n_states:].T
    dense[n_states:, n_states:] = constants
    d = solver.data
    marks = landmark_covariances(dense, d.frame, d.start, bare.E, C_inv, N_STATE)
    return Marginals(dense, marks, information, response)


@dataclass(frozen=True)
class AxesDerivative:
    """Moments and axes of J_G with their derivatives in xi (delta method)."""

    moments: Array
    R_GP: Array
    ratios: Array
    """(2, 5) d(k1, k2) / d xi"""
    axes: Array
    """(3, 5) d theta / d xi, theta in R_GP Exp(theta)"""


def axes_derivative(form: InertiaForm, iterate: Iterate) -> AxesDerivative:
    """First-order change of moments and axes; nearly equal moments give large, finite derivatives."""
    J = iterate.J_G(form)
    moments, R = principal_axes(J)
    values = np.diag(R.T @ J @ R)
    ratios, axes = np.zeros((2, 5)), np.zeros((3, 5))
    step = 1e-6
    for n in range(5):
        change = np.zeros(5)
        change[n] = step
        after = inertia_from_second_moments(form.second_moments(iterate.xi + change, iterate.R_inertia))
        before = inertia_from_second_moments(form.second_moments(iterate.xi - change, iterate.R_inertia))
        M = R.T @ (after - before) @ R / (2.0 * step)
        relative = np.diag(M) / values
        ratios[:, n] = relative[0] - relative[1], relative[1] - relative[2]
        axes[0, n] = M[2, 1] / _gap(values[1] - values[2], values[1])
        axes[1, n] = -M[0, 2] / _gap(values[0] - values[2], values[1])
        axes[2, n] = M[1, 0] / _gap(values[0] - values[1], values[1])
    return AxesDerivative(moments, R, ratios, axes)


def _gap(difference: float, middle: float) -> float:
    return max(difference, SMALLEST_GAP * middle)


def state_jacobian(iterate: Iterate, k: int, derivative: AxesDerivative) -> tuple[Array, Array]:
    """Derivative of (r_N, v_N, theta_P, w_P) of frame k: in its 12 variables, and in (com_G, xi) (12, 8)."""
    R, R_GP = iterate.R_NG[k], derivative.R_GP
    own, constants = np.zeros((12, N_STATE)), np.zeros((12, N_CONSTANTS))
    # r_N = p + R com
    own[0:3, 0:3], own[0:3, 3:6] = np.eye(3), -R @ hat(iterate.com_G)
    constants[0:3, 0:3] = R
    own[3:6, 6:9] = np.eye(3)
    # R_NG Exp(theta_G) R_GP Exp(theta_GP)
    own[6:9, 3:6] = R_GP.T
    constants[6:9, 3:8] = derivative.axes
    # w_P = (R_GP Exp(theta_GP))^T w_G
    own[9:12, 9:12] = R_GP.T
    constants[9:12, 3:8] = hat(R_GP.T @ iterate.w_G[k]) @ derivative.axes
    return own, constants


def state_covariances(iterate: Iterate, m: Marginals, derivative: AxesDerivative) -> tuple[Array, Array]:
    """Covariances (F, 12, 12) of the states, and the last one jointly with xi and com_G (20, 20)."""
    n = N_STATE * iterate.n_frames
    out = np.zeros((iterate.n_frames, 12, 12))
    for k in range(iterate.n_frames):
        own, constants = state_jacobian(iterate, k, derivative)
        at = np.r_[N_STATE * k : N_STATE * k + N_STATE, n : n + N_CONSTANTS]
        T = np.hstack([own, constants])
        out[k] = T @ m.dense[np.ix_(at, at)] @ T.T
        if k == iterate.n_frames - 1:
            order = np.r_[15:20, 12:15]
            T = np.vstack([T, np.eye(20)[order]])
            joint = T @ m.dense[np.ix_(at, at)] @ T.T
    return out, joint


def last_body_covariance(iterate: Iterate, m: Marginals) -> Array:
    """Covariance (20, 20) of the last r_N, v_N, theta in R_NG Exp(theta), w_G, then xi, com_G.

    Free of the principal axes, so it stays finite where they are undetermined; the prior bounds the rest.
    """
    own, constants = np.zeros((12, N_STATE)), np.zeros((12, N_CONSTANTS))
    R, n = iterate.R_NG[-1], N_STATE * iterate.n_frames
    own[0:3, 0:3], own[0:3, 3:6] = np.eye(3), -R @ hat(iterate.com_G)
    constants[0:3, 0:3] = R
    own[3:6, 6:9] = own[6:9, 3:6] = own[9:12, 9:12] = np.eye(3)
    at = np.r_[n - N_STATE : n, n : n + N_CONSTANTS]
    T = np.vstack([np.hstack([own, constants]), np.eye(20)[np.r_[15:20, 12:15]]])
    return np.asarray(T @ m.dense[np.ix_(at, at)] @ T.T)


def robust_information(s: Array, scale: float) -> Array:
    """Information (M,) that each observation contributes under the Cauchy kernel, s its squared norm.

    Huber's sandwich for an M-estimator, per degree of freedom: a^2 / b with a = mean(psi'), b = mean(psi^2),
    shared out in proportion to the weights. Equals 1 on average for a loose kernel and Gaussian noise.
    The noise level is known by now, residuals are smaller by what the fit took: they are scaled back to it.
    """
    s = s * (3.0 / max(float(np.mean(s)), 1e-12))
    w = 1.0 / (1.0 + s / scale**2)
    slope = np.mean(w - (2.0 / 3.0) * s * w**2 / scale**2)
    spread = np.mean(w**2 * s) / 3.0
    return np.asarray(w / np.mean(w) * max(float(slope), 0.1) ** 2 / max(float(spread), 1e-12))
